"""First natural frequency of the papers' axes against position, preload and payload, drawn into ``docs/figures``.

``python -m benchmarks.plots`` writes the figures again; the same models give the same bytes. The axes are those of
``replay_data/models``, each with the family of its own paper: four different machines.
"""

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monitor_core.models.families import FAMILIES
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd
from monitor_core.recordings.modal_csv import ModalRow, read_modal_table
from monitor_core.recordings.model_file import read_model_file

PROJECT = Path(__file__).resolve().parent.parent
FIGURES = PROJECT / "docs" / "figures"
STYLE = {
    "svg.hashsalt": "preload-monitor",  # else the names of clip paths are drawn by lot
    "svg.fonttype": "none",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.88",
    "legend.frameon": False,
}
#: Told apart by dashes and grey, without colour.
ENDS = {
    MotorEnd.CLAMPED: {"color": "0.0", "linestyle": "-"},
    MotorEnd.FREE: {"color": "0.45", "linestyle": "--"},
    MotorEnd.PRESCRIBED: {"color": "0.25", "linestyle": ":", "linewidth": 2.0},
}
NAMES = {
    MotorEnd.CLAMPED: "motor clamped",
    MotorEnd.FREE: "motor free",
    MotorEnd.PRESCRIBED: "torque prescribed (as a sensor sees it)",
}
TITLES = {
    "lumped": "lumped, Nguyen et al.",
    "hybrid": "hybrid, Sun et al.",
    "receptance": "receptance, Tian et al.",
    "transmission-line": "transmission line, Moreno-Castaneda et al.",
}
#: What Nguyen's nut is preloaded with where the preload is not what varies. [N]
PRELOAD = 200.0


def axes_of_the_papers() -> Iterator[tuple[str, DriveModel, dict[str, float]]]:
    """Yield family, model and parameters of each file."""
    for family in FAMILIES:
        file = read_model_file(PROJECT / "replay_data" / "models" / f"{family.name}.toml")
        yield family.name, file.build(), dict(file.parameters)


def first_mode(model: DriveModel, conditions: DriveConditions, end: MotorEnd) -> float:
    """Return the first natural frequency above the rigid-body motion. [Hz]."""
    return next(mode.frequency for mode in model.natural_frequencies(conditions, end) if mode.frequency > 0.0)


def measured_by_nguyen() -> tuple[ModalRow, ...]:
    """Return Table 2 of Nguyen et al. (2018): means of twenty readings each."""
    return tuple(read_modal_table(PROJECT / "replay_data" / "published" / "nguyen_table2.csv"))


def show_measured(axes: Axes, points: list[tuple[float, float, float]], **style: object) -> None:
    """Draw points (x, frequency, its scatter) with bars of twice the standard uncertainty of a mean of twenty."""
    x, frequency, scatter = np.array(points).T
    look = {"color": "0.0", "marker": "o", "linestyle": "none", "markersize": 4.0, "capsize": 2.0, "linewidth": 0.8}
    axes.errorbar(x, frequency, 2.0 * scatter / np.sqrt(20.0), **(look | style))


def four_panels(title: str) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with one panel for each family."""
    figure = Figure(figsize=(7.4, 5.6), layout="constrained")
    panels = figure.subplots(2, 2).ravel()
    figure.suptitle(title, fontsize=10.0)
    return figure, dict(zip(TITLES, panels, strict=True))


def finish(figure: Figure, panels: dict[str, Axes], abscissa: str) -> Figure:
    """Label the panels and give all of them one legend below."""
    entries = {}
    for name, axes in panels.items():
        axes.set_title(TITLES[name], fontsize=9.0)
        axes.set_xlabel(abscissa)
        axes.set_ylabel("natural frequency in Hz")
        axes.set_ylim(*padded(axes))
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=3 if len(entries) == 3 else 2)
    return figure


def padded(axes: Axes) -> tuple[float, float]:
    """Return limits with room around the curves; from zero where these span more than half of their height."""
    low, high = axes.dataLim.y0, axes.dataLim.y1
    room = 0.08 * (high - low)
    return (0.0 if high - low > 0.5 * high else low - room, high + room)


def against_position() -> Figure:
    """Draw the first mode along each screw, for each motor end."""
    figure, panels = four_panels("First natural frequency along the screw, without payload")
    for name, model, values in axes_of_the_papers():
        preload = PRELOAD if "dynamic_load_rating_n" in values else None
        positions = np.linspace(0.05, 0.95, 61) * values["screw_length_m"]
        for end, style in ENDS.items():
            frequencies = [first_mode(model, DriveConditions(x, preload), end) for x in positions.tolist()]
            panels[name].plot(1e3 * positions, frequencies, label=NAMES[end], **style)
    rows = [row for row in measured_by_nguyen() if row.preload == PRELOAD]
    points = [(1e3 * row.position, row.frequency, row.frequency_std or 0.0) for row in rows]
    show_measured(panels["lumped"], points, label=f"measured at {PRELOAD:.0f} N (Nguyen, Table 2; mean ± 2 u)")
    return finish(figure, panels, "position of the table in mm")


def against_payload() -> Figure:
    """Draw the first mode of a table in mid-screw that carries up to half its own mass."""
    figure, panels = four_panels("First natural frequency under payload, table in mid-screw")
    for name, model, values in axes_of_the_papers():
        preload = PRELOAD if "dynamic_load_rating_n" in values else None
        payloads = np.linspace(0.0, 0.5, 26) * values["table_mass_kg"]
        middle = 0.5 * values["screw_length_m"]
        for end, style in ENDS.items():
            frequencies = [first_mode(model, DriveConditions(middle, preload, m), end) for m in payloads.tolist()]
            panels[name].plot(payloads, frequencies, label=NAMES[end], **style)
    return finish(figure, panels, "payload in kg")


def against_preload() -> Figure:
    """Draw the first mode of each axis whose nut follows the preload, beside Nguyen's measurements."""
    figure = Figure(figsize=(7.4, 4.0), layout="constrained")
    ends = (MotorEnd.CLAMPED, MotorEnd.PRESCRIBED)
    panels = figure.subplots(1, len(ends), sharey=True)
    figure.suptitle("First natural frequency over the preload: lumped model of Nguyen's axis", fontsize=10.0)
    _, model, values = next(axis for axis in axes_of_the_papers() if "dynamic_load_rating_n" in axis[2])
    preloads = np.linspace(30.0, 0.1 * values["dynamic_load_rating_n"], 61)
    looks = {0.25: ("-", "o"), 0.5: ("--", "s"), 0.75: (":", "^")}
    for axes, end in zip(panels, ends, strict=True):
        for position, (line, marker) in looks.items():
            frequencies = [first_mode(model, DriveConditions(position, p), end) for p in preloads.tolist()]
            axes.plot(preloads, frequencies, color="0.25", linestyle=line, label=f"{1e3 * position:.0f} mm, model")
            rows = [row for row in measured_by_nguyen() if row.position == position]
            points = [(row.preload or 0.0, row.frequency, row.frequency_std or 0.0) for row in rows]
            show_measured(axes, points, marker=marker, label=f"{1e3 * position:.0f} mm, measured (Table 2; mean ± 2 u)")
        axes.set_title(NAMES[end], fontsize=9.0)
        axes.set_xlabel("preload in N")
    panels[0].set_ylabel("natural frequency in Hz")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


PLOTS = {
    "frequency-against-position": against_position,
    "frequency-against-preload": against_preload,
    "frequency-against-payload": against_payload,
}


def main() -> None:
    """Write all figures."""
    FIGURES.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, draw in PLOTS.items():
            draw().savefig(FIGURES / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
