r"""Read a nut from torque and position alone: friction over the position, and which orders of the screw the torque has.

Motion at one speed, there and back. Neither an accelerometer nor a calibration is needed, nor a preload that was set.

* **Friction.** What changes sign with the direction is friction, what does not is weight or a zero error. Means are
  taken over whole turns of the screw, so that what repeats with the turn drops out.
* **Orders.** The torque is transformed over the angle of the screw that the encoder shows, not over time: an order is
  what repeats so often in a turn, whatever the speed does (order analysis, ISO 13373-2). Over time the same stretches
  are transformed as well: a line that is taller there, as of the mains, is no order, and is taken out.

A line of amplitude A in M independent stretches with a noise floor F, the mean square of what noise alone makes there,
has

.. math:: 2 M \bar P / F \sim \chi^2_{2M}(2 M A^2 / F)

with the mean P̄ of the squared amplitudes of the stretches. It is there where chance alone would seldom show as much,
and the interval of A is that of the noncentrality. A screw that is rough over the place is as rough in each travel: J
travels of one section, of whose floor the part q is the same in each, are J/(1 + q(J − 1)) independent ones.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.cross_checks import refuse_wraps
from monitor_core.errors import OutsideValidityError
from monitor_core.preload.drag_torque import FEWEST_PAIRS, mean_of, velocity_of
from monitor_core.recording import ExcitationQuantity, Rejection, RejectionReason, ResponseQuantity, Window
from monitor_core.uncertainty import Estimate

#: Span over which a speed is told [s]: steps of a coarse encoder must not end a travel.
_SPEED_SPAN = 0.04
#: A travel goes on while the speed is this near to the one at which most of the way was gone, relative, ...
_SPEED_TOLERANCE = 0.25
#: ... is at least so long a part of the longest, and loses so much at either end: the servo settles.
_SHORTEST_TRAVEL, _TRIMMED = 0.5, 0.05
#: Places of a friction profile at the most, and those from whose differences its noise is told at the least.
_MOST_PLACES, _FEWEST_PLACES = 25, 8
#: Turns of the screw in a stretch: of fewer, orders are not apart; of more, balls that slip widen their lines.
_FEWEST_TURNS, _MOST_TURNS = 6.0, 30.0
#: Highest order, where balls do not call for a higher one, and samples in a period of the highest.
_HIGHEST_ORDER, _SAMPLES_PER_PERIOD = 12.0, 4.0
#: Lines of the transform in 1/turns: fine enough for a parabola through three to tell the top of a line.
_FINENESS = 6
#: Half the width of a line of the Hann window, and where its floor begins, in 1/turns; floor on either side, in orders.
_LOBE, _BESIDE, _FLOOR_REACH, _FEWEST_FLOOR = 2.0, 3.0, 1.0, 2
#: A median of noise tells its floor so well as this part of its values would by their mean.
_MEDIAN_EFFICIENCY = 0.64
#: Between names of one line that lie too near each other to be two.
OR = " or "
#: Harmonics of the screw that are named.
_HARMONICS = 3
#: Of the balls' order, relative: they lie loosely in their track, and a contact angle varies with the load.
_BALLS_FROM, _BALLS_TO = -0.03, 0.02
#: A line is said to be there where chance alone would show as much once in a thousand spectra.
_CHANCE = 1e-3
#: Over time or over angle: the one whose line is taller, in power, by this part and so many of its standard deviations.
#: Else the speed was too even to tell.
_TALLER, _DEVIATIONS = 0.02, 4.0
#: Lines that are taken out one after the other, the highest first, each judged without those above it; those without a
#: name that are told.
_MOST_LINES, _MOST_OTHERS = 12, 5


@dataclass(frozen=True, slots=True)
class Screw:
    """What names the orders: lead, and the balls of the nut where they are known."""

    lead: float  # travel per turn [m]
    ball_diameter: float | None = None  # [m]
    pitch_circle: float | None = None  # diameter of the circle of the ball centres [m]
    contact_angle: float = math.radians(45.0)  # of balls and track, from the radius [rad]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lead) and self.lead > 0.0):
            raise OutsideValidityError(f"lead must be positive; got {self.lead} m")
        ball, circle = self.ball_diameter, self.pitch_circle
        if (ball is None) != (circle is None):
            raise OutsideValidityError("the balls' order needs both: ball diameter and diameter of the pitch circle")
        if ball is not None and circle is not None and not 0.0 < ball < circle:
            raise OutsideValidityError(f"balls must be smaller than their pitch circle; got {ball} m in {circle} m")
        if not 0.0 <= self.contact_angle < 0.5 * math.pi:
            raise OutsideValidityError(f"contact angle must lie from 0 to 90°; got {self.contact_angle} rad")

    @property
    def names(self) -> dict[str, float]:
        """Orders that have a name."""
        orders = {"screw" if n == 1 else f"screw × {n}": float(n) for n in range(1, _HARMONICS + 1)}
        if self.ball_diameter is not None and self.pitch_circle is not None:
            nut, screw = ball_pass_orders(self.lead, self.ball_diameter, self.pitch_circle, self.contact_angle)
            orders |= {"balls past the nut": nut, "balls past the screw": screw}
        return orders


def ball_pass_orders(
    lead: float, ball_diameter: float, pitch_circle: float, contact_angle: float
) -> tuple[float, float]:
    r"""Return how many balls pass a place of the nut, and one of the screw, in a turn of the screw.

    .. math::

        n_\mathrm{nut,\,screw} = \frac{\pi D}{2 d \cos\psi}
        \left( 1 \mp \frac{d}{D} \cos\alpha \cos^2\psi \right), \qquad \tan\psi = \frac{P_h}{\pi D}

    with the lead :math:`P_h`, ball diameter d and pitch circle D [m] and the contact angle α [rad]. A ball that rolls
    between nut and screw goes along the helix half as fast as the point of the screw that it touches [1]_; ψ = 0 is the
    ball bearing [2]_. The balls of a full complement touch each other; with spacers between, every other one counts.

    Examples
    --------
    Without a lead, and balls that touch at the bottom of the track: half of 10 π balls, less a tenth, and more.

    >>> [round(order / math.pi, 6) for order in ball_pass_orders(0.0, 0.004, 0.040, 0.0)]
    [4.5, 5.5]

    References
    ----------
    .. [1] M. C. Lin, B. Ravani, S. A. Velinsky, Kinematics of the ball screw mechanism, J. Mech. Des. 116 (1994)
       849-855.
    .. [2] T. A. Harris, M. N. Kotzalas, Essential concepts of bearing technology, 5th ed., 2006, ch. 10.
    """
    cos = math.cos(math.atan2(lead, math.pi * pitch_circle))
    passing = 0.5 * math.pi * pitch_circle / (ball_diameter * cos)
    slower = ball_diameter / pitch_circle * math.cos(contact_angle) * cos**2
    return passing * (1.0 - slower), passing * (1.0 + slower)


@dataclass(frozen=True, slots=True, eq=False)
class FrictionProfile:
    """Friction over the position, from travels both ways; positive whichever way torque and position count."""

    position: FloatArray  # middles of the places, shape (n_places,) [m]
    friction: FloatArray  # (T₊ − T₋)/2 [unit of the torque]
    offset: FloatArray  # (T₊ + T₋)/2: weight, imbalance, zero error
    standard_uncertainty: float  # of the friction at one place
    drag: Estimate  # mean friction
    mean_offset: Estimate
    speed: float  # [m/s]
    n_travels: tuple[int, int]  # forward, back

    @property
    def repeats(self) -> bool:
        """Whether what differs from travel to travel is in the uncertainties."""
        return min(self.n_travels) >= FEWEST_PAIRS


@dataclass(frozen=True, slots=True)
class OrderLine:
    """What the torque does so often in a turn of the screw: an amplitude with its 95 % interval."""

    name: str  # empty: nothing that lead or balls name
    order: float  # per turn; of balls where the line is highest
    amplitude: float  # root mean square of the stretches' amplitudes, without the floor's share [unit of the torque]
    lower: float
    upper: float
    is_there: bool  # it stands out of the noise around it
    told_from_time: bool  # the speed varied enough to tell that it is none over time


@dataclass(frozen=True, slots=True, eq=False)
class OrderSpectrum:
    """Amplitudes over the orders of the screw."""

    orders: FloatArray  # shape (n_orders,) [1/turn]
    amplitudes: FloatArray  # noise included [unit of the torque]
    lines: tuple[OrderLine, ...]  # those with a name, then others that stand out
    ripples: tuple[tuple[float, float], ...]  # over time, taken out: frequency [Hz] and amplitude
    turns: float  # of a stretch
    n_stretches: int


@dataclass(frozen=True, slots=True)
class TorqueReading:
    """What torque and position say of one measurement."""

    profile: FrictionProfile | Rejection
    spectrum: OrderSpectrum | Rejection
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class _Travel:
    """Samples of a way at one speed."""

    rate: float  # [Hz]
    torque: FloatArray
    position: FloatArray  # [m]
    speed: float  # mean velocity, with its sign [m/s]


def read_torque(windows: Sequence[Window], screw: Screw) -> TorqueReading | Rejection:
    """Return friction and orders of the windows of one measurement, or why they tell neither.

    The excitation is a torque, force or current of the motor; the position is the position trace, or else the response,
    where that is the motor angle or the displacement of the table. Each window holds whole travels.
    """
    if (refusal := _refuse_channels(windows)) is not None:
        return refusal
    places = [_position(window, screw) for window in windows]
    if any(place is None for place in places):
        return _refused(
            "expected the position as a trace, motor angle or displacement; got " + windows[0].response_quantity
        )
    traces = [*(window.excitation for window in windows), *(place for place in places if place is not None)]
    if lost := sum(int(np.count_nonzero(~np.isfinite(trace))) for trace in traces):
        return _refused(
            f"expected finite samples of torque and position; got {lost} that are not", RejectionReason.NOT_FINITE
        )
    travels = _travels([(window, place) for window, place in zip(windows, places, strict=True) if place is not None])
    if not travels:
        return _refused("expected travels at one speed; got none", RejectionReason.TOO_FEW_AVERAGES)
    unit = windows[0].excitation_quantity.unit
    return TorqueReading(_profile(travels, screw.lead), _spectrum(travels, screw), unit)


def _refuse_channels(windows: Sequence[Window]) -> Rejection | None:
    for window in windows:
        if window.excitation_quantity is ExcitationQuantity.ACCELERATION:
            return _refused("expected torque, force or current of the motor; got a commanded acceleration")
        if (refusal := refuse_wraps(window)) is not None:
            return refusal
    if len({window.excitation_quantity for window in windows}) > 1:
        return _refused("expected one quantity of the motor in all windows; got several")
    return None


def _refused(detail: str, reason: RejectionReason = RejectionReason.EXCITATION_SOURCE_MISMATCH) -> Rejection:
    return Rejection(reason, detail)


def _position(window: Window, screw: Screw) -> FloatArray | None:
    if window.position_trace is not None:
        return window.position_trace
    if window.response_quantity is ResponseQuantity.MOTOR_ANGLE:
        return np.asarray(window.response, dtype=np.float64) * screw.lead / (2.0 * math.pi)
    if window.response_quantity is ResponseQuantity.DISPLACEMENT:
        return np.asarray(window.response, dtype=np.float64)
    return None


def _travels(recorded: Sequence[tuple[Window, FloatArray]]) -> list[_Travel]:
    """Cut records into travels at the speed at which most of the way was gone."""
    velocities = [velocity_of(place[None, :], window.sample_rate, _SPEED_SPAN)[0] for window, place in recorded]
    speeds = np.concatenate([np.abs(velocity) for velocity in velocities])
    steps = np.concatenate(
        [np.abs(v) / window.sample_rate for v, (window, _) in zip(velocities, recorded, strict=True)]
    )
    order = np.argsort(speeds)
    way = np.cumsum(steps[order])
    if not way[-1] > 0.0:
        return []
    usual = float(speeds[order][np.searchsorted(way, 0.5 * way[-1])])
    travels = []
    for velocity, (window, place) in zip(velocities, recorded, strict=True):
        at_speed = np.abs(np.abs(velocity) - usual) <= _SPEED_TOLERANCE * usual
        for begin, end in _stretches(at_speed):
            off = max(round(_TRIMMED * (end - begin)), round(0.5 * _SPEED_SPAN * window.sample_rate))
            kept = slice(begin + off, end - off)
            if end - begin > 2 * off + 1:
                way_gone = float(place[kept][-1] - place[kept][0])
                speed = way_gone * window.sample_rate / (end - begin - 2 * off - 1)
                torque = np.asarray(window.excitation[kept], dtype=np.float64)
                travels.append(_Travel(window.sample_rate, torque, place[kept], speed))
    longest = max((abs(float(t.position[-1] - t.position[0])) for t in travels), default=0.0)
    return [t for t in travels if abs(t.position[-1] - t.position[0]) >= _SHORTEST_TRAVEL * longest > 0.0]


def _stretches(holds: BoolArray) -> Iterator[tuple[int, int]]:
    ends = np.flatnonzero(np.diff(np.pad(holds.astype(np.int8), 1)))
    yield from zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True)


# --- friction over the position


def _profile(travels: Sequence[_Travel], lead: float) -> FrictionProfile | Rejection:
    low = max(float(t.position.min()) for t in travels)
    high = min(float(t.position.max()) for t in travels)
    turns = (high - low) / lead
    forward, back = ([t for t in travels if t.speed * sign > 0.0] for sign in (1.0, -1.0))
    if turns < 1.0 or not forward or not back:
        return _refused(
            f"friction needs travels both ways over the same turn of the screw; got {len(forward)} forward and "
            f"{len(back)} back, with {max(turns, 0.0):.1f} turns in common",
            RejectionReason.TOO_FEW_AVERAGES,
        )
    each = max(math.ceil(turns / _MOST_PLACES), 1) * lead  # whole turns: what repeats with them drops out
    edges: FloatArray = low + each * np.arange(math.floor((high - low) / each + 1e-9) + 1.0)
    there, here = (np.array([_means(t, edges) for t in of]) for of in (forward, back))
    n, places = min(len(forward), len(back)), edges.size - 1
    friction, offset = (0.5 * (there.mean(axis=0) + sign * here.mean(axis=0)) for sign in (-1.0, 1.0))
    polarity = math.copysign(1.0, float(friction.mean()))
    pairs = [0.5 * (there[:n] + sign * here[:n]) for sign in (-1.0, 1.0)]
    if n >= FEWEST_PAIRS:
        drag, mean_offset = (mean_of(of.mean(axis=1)) for of in pairs)
        # about the mean of its place, over all places
        noise = math.sqrt(float(np.var(pairs[0], axis=0, ddof=1).mean()) / n)
    elif places >= _FEWEST_PLACES:
        drag, mean_offset = _by_places(friction), _by_places(offset)
        noise = drag.standard_uncertainty * math.sqrt(places)
    else:
        return _refused(
            f"friction needs {FEWEST_PAIRS} travels each way, or {_FEWEST_PLACES} turns of the screw; got {n} each way "
            f"over {turns:.1f} turns",
            RejectionReason.TOO_FEW_AVERAGES,
        )
    return FrictionProfile(
        position=0.5 * (edges[1:] + edges[:-1]),
        friction=polarity * friction,
        offset=offset,
        standard_uncertainty=noise,
        drag=Estimate(polarity * float(friction.mean()), drag.standard_uncertainty, drag.degrees_of_freedom),
        mean_offset=Estimate(float(offset.mean()), mean_offset.standard_uncertainty, mean_offset.degrees_of_freedom),
        speed=float(np.mean([abs(t.speed) for t in travels])),
        n_travels=(len(forward), len(back)),
    )


def _means(travel: _Travel, edges: FloatArray) -> FloatArray:
    """Return the mean torque between edges, over the way."""
    way = np.gradient(travel.position)
    at = np.searchsorted(edges, travel.position, side="right")
    sums, ways = (np.bincount(at, of, edges.size + 1)[1:-1] for of in (travel.torque * way, way))
    return sums / np.where(ways == 0.0, np.nan, ways)


def _by_places(values: FloatArray) -> Estimate:
    """Return the mean with the noise that second differences of neighbours show: what changes slowly is no noise.

    Variance Σd²/6(n − 2); of normal noise as good as (n − 2)·18/35 degrees of freedom.
    """
    d = np.diff(values, 2)
    variance = float(d @ d) / (6.0 * d.size)
    return Estimate(float(values.mean()), math.sqrt(variance / values.size), d.size * 18.0 / 35.0)


# --- orders


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """A section of the screw in one travel, ready to be transformed."""

    section: tuple[bool, int]  # whether it was gone forward, and which
    angle: FloatArray  # of one origin in all stretches [turns]
    time: FloatArray  # [s]
    torque: FloatArray  # without mean and slope
    taper: FloatArray  # by the way; its sum is 2, so that a transform is an amplitude

    @property
    def speed(self) -> float:
        """Mean speed [turns/s]."""
        return float((self.angle[-1] - self.angle[0]) / self.time[-1])

    def transform(self, variable: FloatArray, first: float, step: float, n: int) -> ComplexArray:
        """Return the complex amplitudes at n frequencies over angle or time."""
        turned = self.taper * self.torque * np.exp(-2j * math.pi * first * variable)
        on = np.exp(-2j * math.pi * step * variable)
        sums = np.empty(n, dtype=np.complex128)
        for number in range(n):
            sums[number] = turned.sum()
            turned *= on
        return sums

    def without(self, variable: FloatArray, frequency: float) -> "_Stretch":
        """Return the stretch without its line of a frequency over angle or time."""
        phase = 2.0 * math.pi * frequency * variable
        columns = np.column_stack([np.cos(phase), np.sin(phase)])
        of = (self.taper[:, None] * columns).T
        return replace(self, torque=self.torque - columns @ np.linalg.solve(of @ columns, of @ self.torque))


def _spectrum(travels: Sequence[_Travel], screw: Screw) -> OrderSpectrum | Rejection:
    shortest = min(abs(float(t.position[-1] - t.position[0])) for t in travels) / screw.lead
    samples = min(t.rate / abs(t.speed) * screw.lead for t in travels)
    turns = shortest / math.ceil(shortest / _MOST_TURNS)
    highest = min(max(_HIGHEST_ORDER, 1.2 * max(screw.names.values())), samples / _SAMPLES_PER_PERIOD)
    if turns < _FEWEST_TURNS or highest < 2.0:
        return _refused(
            f"orders need {_FEWEST_TURNS:g} turns of the screw in a travel, with {2.0 * _SAMPLES_PER_PERIOD:g} samples "
            f"in each; got {shortest:.1f} turns with {samples:.1f}",
            RejectionReason.TOO_FEW_AVERAGES,
        )
    origin = min(float(t.position.min()) for t in travels)
    stretches = [each for travel in travels for each in _cut(travel, screw.lead, turns, origin)]
    step = 1.0 / math.ceil(_FINENESS * turns)  # whole orders are among the lines
    orders: FloatArray = step * np.arange(math.floor(highest / step) + 1.0)
    ripples, told = list[tuple[float, float]](), list[OrderLine]()
    whole = lines = _Lines.of(stretches, orders, turns, screw.names)
    while len(told) + len(ripples) < _MOST_LINES and (line := lines.highest(told)) is not None:
        frequency, height, margin = lines.over_time(line.order)
        if height > (1.0 + margin) * line.amplitude**2:
            ripples.append((frequency, math.sqrt(height)))
            stretches = [each.without(each.time, frequency) for each in stretches]
        else:
            told.append(line)
            stretches = [each.without(each.angle, line.order) for each in stretches]
        lines = _Lines.of(stretches, orders, turns, screw.names, tuple(frequency for frequency, _ in ripples))
    names = dict[str, OrderLine]()  # of two in the range of one name the higher, which was told first, has it
    for line in told:
        for name in line.name.split(OR):
            names.setdefault(name, line)
    named = [names.get(name) or lines.line(name) for name in screw.names]
    others = [replace(line, name="") for line in told if not line.name or line not in names.values()][:_MOST_OTHERS]
    lines_told = dict.fromkeys([*(line for line in named if line is not None), *others])
    amplitudes = np.sqrt(whole.powers.mean(axis=0))
    return OrderSpectrum(orders, amplitudes, tuple(lines_told), tuple(ripples), turns, n_stretches=len(stretches))


def _cut(travel: _Travel, lead: float, turns: float, origin: float) -> Iterator[_Stretch]:
    """Cut a travel into stretches of so many turns, from its lower end on: the same places there and back."""
    sense = math.copysign(1.0, travel.speed)
    angle = sense * travel.position / lead
    lowest, highest = np.sort(travel.position[[0, -1]] / lead).tolist()
    places = np.sort(sense * (lowest + turns * np.arange(math.floor((highest - lowest) / turns + 1e-9) + 1.0)))
    at = np.minimum(np.searchsorted(np.maximum.accumulate(angle), places), angle.size - 1)
    for begin, end in pairwise(at.tolist()):
        of, torque = angle[begin : end + 1], travel.torque[begin : end + 1]
        gone = of - of[0]
        taper = (1.0 - np.cos(2.0 * math.pi * gone / gone[-1])) * np.gradient(of)
        taper *= 2.0 / taper.sum()
        centred = gone - 0.5 * gone[-1]
        slope = float((taper * centred) @ torque) / float((taper * centred) @ centred)
        torque = torque - 0.5 * float(taper @ torque) - slope * centred
        section = round((float(travel.position[[begin, end]].min()) - origin) / (lead * turns))
        yield _Stretch((sense > 0.0, section), of, np.arange(of.size) / travel.rate, torque, taper)


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """The spectrum of stretches, and what stands out of it."""

    stretches: Sequence[_Stretch]
    orders: FloatArray
    powers: FloatArray  # shape (n_stretches, n_orders)
    alike: tuple[FloatArray, FloatArray]  # over orders: power that travels of one section have in common, and all of it
    n_sections: int
    lobe: float  # half the width of a line [1/turn]
    names: dict[str, float]
    ripples: tuple[float, ...]  # that were taken out [Hz]

    @classmethod
    def of(
        cls, stretches: Sequence[_Stretch], orders: FloatArray, turns: float, names: dict[str, float],
        ripples: tuple[float, ...] = (),
    ) -> "_Lines":  # fmt: skip
        """Transform stretches over the angle."""
        found = np.array([each.transform(each.angle, 0.0, float(orders[1]), orders.size) for each in stretches])
        powers = np.abs(found) ** 2
        common, whole = np.zeros((2, orders.size))
        sections = [each.section for each in stretches]
        for section in set(sections):
            of = [at == section for at in sections]
            own = powers[of].sum(axis=0)
            common += np.abs(found[of].sum(axis=0)) ** 2 - own
            whole += (sum(of) - 1.0) * own
        n_sections = len({number for _, number in sections})
        return cls(stretches, orders, powers, (common, whole), n_sections, _LOBE / turns, names, ripples)

    def highest(self, told: Sequence[OrderLine]) -> OrderLine | None:
        """Return the highest line that stands out beside those told already; None if there is none."""
        power = self.powers.mean(axis=0)
        inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
        inner = inner[np.argsort(-power[inner])]
        for order in self.orders[inner[: 2 * _MOST_LINES]].tolist():
            if any(abs(order - other.order) < self.lobe for other in told):
                continue
            line = next(
                (self.line(name) for name in self.names if self._has(name, order)), self._line("", order, order)
            )
            if line is not None and line.is_there:
                return line
        return None

    def line(self, name: str) -> OrderLine | None:
        """Judge the line of a name; None where the spectrum does not reach or a ripple hides it."""
        order = self.names[name]
        # what is no farther apart than a line is wide is one line of several names
        alike = [other for other, at in self.names.items() if abs(at - order) < self.lobe]
        return self._line(OR.join(alike), *self._range(name))

    def _range(self, name: str) -> tuple[float, float]:
        loose = (_BALLS_FROM, _BALLS_TO) if name.startswith("balls") else (0.0, 0.0)
        return self.names[name] * (1.0 + loose[0]), self.names[name] * (1.0 + loose[1])

    def _has(self, name: str, order: float) -> bool:
        low, high = self._range(name)
        return low - 0.25 * self.lobe <= order <= high + 0.25 * self.lobe

    def _line(self, name: str, low: float, high: float) -> OrderLine | None:
        """Judge the highest line between two orders; one without a name is one of all the spectrum has."""
        first, last = (round(order / self.orders[1]) for order in (low, high))
        middle = 0.5 * (low + high)
        usable = [all(abs(f / each.speed - middle) > self.lobe for f in self.ripples) for each in self.stretches]
        if last + 1 >= self.orders.size or low < 2.0 * self.lobe or not any(usable):
            return None
        powers = self.powers[usable].mean(axis=0)
        at = first + int(np.argmax(powers[first : last + 1]))
        order, power = float(self.orders[at]), float(powers[at])
        if last > first or not name:
            order, power = _top(self.orders, powers, at)
        floor, n_values, travels = self._floor(order)
        if n_values < _FEWEST_FLOOR or not floor > 0.0:
            return None
        m = 2.0 * sum(usable) / travels
        freedom = 2.0 * _MEDIAN_EFFICIENCY * len(self.stretches) / travels * n_values
        chance = float(scipy.special.fdtrc(m, freedom, power / floor))
        looks = 1.0 + 2.0 * (high - low if name else float(self.orders[-1])) / self.lobe
        is_there = chance * looks < _CHANCE
        # a floor of few values widens the interval as it does Student's; the upper end is that of the floor at least
        tail = float(scipy.special.ndtr(-scipy.special.stdtrit(freedom, 0.975)))
        lower, upper = (
            math.sqrt(floor / m * float(scipy.special.chndtrinc(m * seen / floor, m, level)))
            for seen, level in ((power, 1.0 - tail), (max(power, floor), tail))
        )
        _, height, margin = self.over_time(order) if is_there else (0.0, 0.0, 0.0)
        return OrderLine(
            name, order, math.sqrt(max(power - floor, 0.0)), lower if is_there else 0.0, upper, is_there,
            told_from_time=power > (1.0 + margin) * height,
        )  # fmt: skip

    def _floor(self, order: float) -> tuple[float, int, float]:
        """Return the mean square of noise around an order, of how many values, and how many travels tell what one does.

        The median of lines that know nothing of each other.
        """
        begin = _BESIDE / _LOBE * self.lobe
        beside = np.arange(begin, max(_FLOOR_REACH, 2.0 * begin + 2.0 * self.lobe), self.lobe)
        places = np.concatenate([order - beside[::-1], order + beside])
        places = places[(places >= self.lobe) & (places <= self.orders[-1])]
        for other in self.names.values():
            if abs(other - order) > 0.5 * self.lobe:
                places = places[np.abs(places - other) >= self.lobe]
        if not places.size:
            return 0.0, 0, 1.0
        at = np.rint(places / self.orders[1]).astype(np.intp)
        common, whole = (float(of[at].sum()) for of in self.alike)
        # of one travel each way nothing tells: the same
        q = min(max(common / whole, 0.0), 1.0) if whole > 0.0 else 1.0
        travels = 1.0 + q * (len(self.stretches) / self.n_sections - 1.0)
        # the median of a mean of M squared amplitudes (Wilson & Hilferty 1931)
        shift = (1.0 - travels / (9.0 * len(self.stretches))) ** 3
        return float(np.median(self.powers.mean(axis=0)[at])) / shift, places.size, travels

    def over_time(self, order: float) -> tuple[float, float, float]:
        """Return frequency [Hz] and squared amplitude of the line over time, and the part by which that may be off."""
        speeds = [each.speed for each in self.stretches]
        length = min(float(each.time[-1]) for each in self.stretches)
        step = 1.0 / (_FINENESS * length)
        first = order * min(speeds) - _LOBE / length
        n = math.ceil((order * max(speeds) + _LOBE / length - first) / step)
        power = np.mean([np.abs(each.transform(each.time, first, step, n)) ** 2 for each in self.stretches], axis=0)
        at = int(np.argmax(power))
        frequency, height = _top(first + step * np.arange(float(n)), power, at)
        floor, _, travels = self._floor(order)
        return frequency, height, _TALLER + _DEVIATIONS * math.sqrt(floor * travels / (len(self.stretches) * height))


def _top(places: FloatArray, power: FloatArray, at: int) -> tuple[float, float]:
    """Return place and height of the parabola through a highest value and its neighbours."""
    if not 0 < at < power.size - 1 or power[at] < max(power[at - 1], power[at + 1]):
        return float(places[at]), float(power[at])
    before, here, after = (float(value) for value in power[at - 1 : at + 2])
    bent = min(before - 2.0 * here + after, -1e-300)
    off = 0.5 * (before - after) / bent
    return float(places[at] + off * (places[1] - places[0])), here - 0.25 * (before - after) * off
