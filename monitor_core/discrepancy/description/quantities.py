"""List the quantities of a drive that may vary from setting to setting, and the place that each of them says."""

import math
from dataclasses import dataclass
from enum import StrEnum

from monitor_core.models.extended import AxisPhysics
from monitor_core.models.parameters import name_in_file


class Place(StrEnum):
    """A place of a drive, by its name in files."""

    TABLE = "table"
    NUT = "nut"
    SCREW = "screw"
    SCREW_END = "screw end"
    BEARING = "bearing"
    MOTOR = "motor"
    BASE = "base"
    SENSOR = "sensor"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of one of the records of a drive."""

    record: str
    field: str
    place: Place
    name: str  # in files, with its unit

    def of(self, axis: AxisPhysics) -> float:
        """Return its value."""
        return float(getattr(getattr(axis, self.record), self.field))

    @property
    def is_frequency(self) -> bool:
        """Whether it is a frequency of its own, as that of an absorber."""
        return self.name.endswith("_hz")


def _stated(record: str, field: str, place: Place) -> Quantity:
    return Quantity(record, field, place, name_in_file(field))


QUANTITIES = (
    _stated("joints", "nut_stiffness", Place.NUT),
    _stated("joints", "nut_damping", Place.NUT),
    _stated("joints", "bracket_stiffness", Place.NUT),
    _stated("joints", "bearing_stiffness", Place.BEARING),
    _stated("joints", "bearing_damping", Place.BEARING),
    _stated("joints", "far_bearing_stiffness", Place.BEARING),
    _stated("joints", "coupling_stiffness", Place.MOTOR),
    _stated("joints", "coupling_damping", Place.MOTOR),
    Quantity("bodies", "rotor_inertia", Place.MOTOR, "motor_inertia_kg_m2"),
    _stated("bodies", "motor_damping", Place.MOTOR),
    _stated("bodies", "table_mass", Place.TABLE),
    _stated("bodies", "table_damping", Place.TABLE),
    Quantity("screw", "axial_rigidity", Place.SCREW, "screw_axial_rigidity_n"),
    Quantity("screw", "torsional_rigidity", Place.SCREW, "screw_torsional_rigidity_nm2"),
    Quantity("added", "table_absorber_frequency", Place.TABLE, "frequency_hz"),
    Quantity("added", "table_absorber_mass", Place.TABLE, "mass_kg"),
    Quantity("added", "nut_absorber_frequency", Place.NUT, "frequency_hz"),
    Quantity("added", "nut_absorber_mass", Place.NUT, "mass_kg"),
    Quantity("added", "rotor_absorber_frequency", Place.MOTOR, "frequency_hz"),
    Quantity("added", "rotor_absorber_inertia", Place.MOTOR, "inertia_kg_m2"),
    Quantity("added", "screw_end_absorber_frequency", Place.SCREW_END, "frequency_hz"),
    Quantity("added", "screw_end_absorber_mass", Place.SCREW_END, "mass_kg"),
    Quantity("added", "guide_stiffness", Place.TABLE, "guide_stiffness_n_per_m"),
    Quantity("added", "base_frequency", Place.BASE, "frequency_hz"),
    Quantity("bending", "frequency", Place.SCREW, "frequency_hz"),
    Quantity("bending", "compliance", Place.SCREW, "compliance_m_per_n"),
)


#: Frequencies that stand for nothing without a size.
_OF_SIZE = {
    "table_absorber_frequency": "table_absorber_mass",
    "nut_absorber_frequency": "nut_absorber_mass",
    "rotor_absorber_frequency": "rotor_absorber_inertia",
    "screw_end_absorber_frequency": "screw_end_absorber_mass",
    "base_frequency": "base_compliance",
}
_OF_BENDING = "frequency"


#: What stands in series, so that responses hardly tell which of the two varies: the solid part, and the contacts.
_CONTACTS = {"bracket_stiffness": "nut_stiffness"}


def contacts_for(quantity: Quantity) -> Quantity | None:
    """Return the quantity of contacts in series with that of a solid part, which a law is believed of first."""
    field = _CONTACTS.get(quantity.field)
    return next((other for other in QUANTITIES if other.field == field), None)


def hung_elsewhere(quantity: Quantity) -> Quantity | None:
    """Return the same quantity of what hangs on the table in place of the nut, or the other way round."""
    of_nut, of_table = ("nut_absorber", "table_absorber")
    field = quantity.field
    other = field.replace(of_nut, of_table) if field.startswith(of_nut) else field.replace(of_table, of_nut)
    return next((each for each in QUANTITIES if each.field == other and other != field), None)


def quantities_of(axis: AxisPhysics) -> tuple[Quantity, ...]:
    """Return the quantities that a drive has; what is zero or infinite plays no part in it."""
    absent = {frequency for frequency, size in _OF_SIZE.items() if not getattr(axis.added, size)}
    absent |= set() if axis.bending.compliance else {_OF_BENDING}
    present = [quantity for quantity in QUANTITIES if quantity.field not in absent]
    return tuple(quantity for quantity in present if math.isfinite(value := quantity.of(axis)) and value != 0.0)
