"""Propose a drive model and a search band for an axis from what a catalogue states of it."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from monitor_core.models import MotorEnd
from monitor_core.recordings.elements.units import metres
from service.operations.fields import KILOGRAMS, RequestModel

if TYPE_CHECKING:
    from monitor_core.models.catalogue import CatalogueData, ExpectedMode


class CatalogueIn(RequestModel):
    """What a catalogue and a scale say of an axis; the defaults are a small milling machine's."""

    # catalogues have screws from 1 mm to 160 mm of diameter, up to 15 m long; the modes of a longer one are a crowd
    screw_diameter_mm: Annotated[float, Field(ge=1, le=1000)] = 20.0
    screw_lead_mm: Annotated[float, Field(ge=0.1, le=1000)] = 6.0
    screw_length_mm: Annotated[float, Field(ge=10, le=20_000, description="between the bearings")] = 971.0
    moved_mass_kg: Annotated[float, KILOGRAMS, Field(description="table, nut and what is fixed to them")] = 22.0
    nut_stiffness_n_per_um: Annotated[
        float, Field(ge=0.01, le=1e5, description="rigidity of the catalogue, at a preload of 10 % of the load rating")
    ] = 470.0
    dynamic_load_rating_n: Annotated[float, Field(ge=1, le=1e8)] = 4000.0
    nut: Literal["double", "oversize-balls"] = "double"
    bearings: Literal["fixed-free", "fixed-supported", "fixed-fixed"] = "fixed-supported"
    excitation_source: Literal["sensor", "drive"] = "sensor"

    def to_core(self) -> "CatalogueData":
        """Return the core's record, in SI units."""
        from monitor_core.models.catalogue import BearingArrangement, CatalogueData, NutKind  # noqa: PLC0415  # a start pays for no analysis

        return CatalogueData(
            screw_diameter=metres(self.screw_diameter_mm),
            screw_lead=metres(self.screw_lead_mm),
            screw_length=metres(self.screw_length_mm),
            moved_mass=self.moved_mass_kg,
            nut_stiffness=self.nut_stiffness_n_per_um * 1e6,
            dynamic_load_rating=self.dynamic_load_rating_n,
            nut_kind=NutKind(self.nut),
            bearings=BearingArrangement(self.bearings),
        )


@dataclass(frozen=True, slots=True)
class AxisProposal:
    """What an axis of such data is registered with."""

    drive_model: str  # TOML
    mode: "ExpectedMode"
    usual_preload: float  # that makers set [N]

    @property
    def search_band_hz(self) -> tuple[float, float]:
        """The band of the mode in whole hertz."""
        low, high = self.mode.band
        return float(round(low)), float(round(high))


@lru_cache(maxsize=64)
def axis_proposal(data: CatalogueIn) -> AxisProposal:
    """Return the drive of catalogue data and the band of its first axial frequency.

    Raises OutsideValidityError in one sentence if no such axis can be.
    """
    from monitor_core import AxisDescription  # noqa: PLC0415  # a start pays for no analysis
    from monitor_core.models.catalogue import drive_from_catalogue, expected_mode  # noqa: PLC0415
    from monitor_core.recordings.model_file import model_file_text  # noqa: PLC0415

    core = data.to_core()
    drive = drive_from_catalogue(core)
    end = MotorEnd.PRESCRIBED if data.excitation_source == "sensor" else MotorEnd.FREE
    description = AxisDescription(drive.family, drive.parameters.to_file_names(), drive.uncertain)
    return AxisProposal(model_file_text(description), expected_mode(drive, end), core.set_preload)
