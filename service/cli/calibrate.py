"""``preload calibrate DATA``: k1…k4 of Nguyen's Eq. (8) with covariance, from a modal table or a session."""

from collections.abc import Sequence
from pathlib import Path

import click

from monitor_core.errors import NotIdentifiableError
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import calibrate_by_drive
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ModalReading,
    Weighting,
    calibrate as fit_calibration,
    calibration_from_prior,
    log_preload,
    minimum_detectable_loss,
    prior_from_calibration,
    with_unset_preload,
)
from monitor_core.recording import ExcitationSource
from monitor_core.recordings.calibration_file import (
    COEFFICIENT_KEYS,
    calibration_document,
    read_calibration,
    write_calibration,
)
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.session import calibrate_judged, excitation_remarks, judge_session
from monitor_core.uncertainty import Estimate
from service.cli.inputs.data import (
    Data,
    DataKind,
    axis_settings,
    band_option,
    calibration_at,
    data_argument,
    data_of,
    map_option,
    opened_session,
)
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table
from service.cli.targets import require_target


@click.command()
@data_argument
@map_option
@click.option(
    "--weighting",
    type=click.Choice([str(w) for w in Weighting]),
    help="std where a modal table states frequency_std_hz for every row, else none.",
)
@click.option("--excitation-source", type=click.Choice([str(s) for s in ExcitationSource]), help="Of a modal table.")
@click.option(
    "--moving-mass-kg", nargs=2, type=float, metavar="KG UNCERTAINTY",
    help="What moves without payload, and its standard uncertainty; used where the data hold one payload only.",
)  # fmt: skip
@click.option(
    "--prior", "prior_file", type=click.Path(path_type=Path),
    help="Calibration whose k1…k4 were known before, predicted or earlier: fewer measurements will do.",
)  # fmt: skip
@click.option(
    "--model", "model_file", type=click.Path(path_type=Path),
    help="Drive model, TOML, with the tolerances of its parts: what it lets expect is the prior, and measurements "
    "whose preload nobody set will do. The interval is wide.",
)  # fmt: skip
@click.option(
    "--preload-n", nargs=2, type=click.FloatRange(min=0, min_open=True), metavar="N UNCERTAINTY",
    help="With --model, preload of the nut in measurements that state none, and its standard uncertainty; without it "
    "2.5 to 7.5 % of the load rating.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Also write the calibration to a file.")
@band_option
@json_option
def calibrate(
    paths: tuple[Path, ...],
    map_path: Path | None,
    weighting: str | None,
    excitation_source: str | None,
    moving_mass_kg: tuple[float, float] | None,
    prior_file: Path | None,
    model_file: Path | None,
    preload_n: tuple[float, float] | None,
    out: Path | None,
    band_hz: tuple[float, float] | None,
    as_json: bool,
) -> None:
    """Fit k1…k4 to measured natural frequencies at several positions and preloads, or join them with a prior."""
    known = [path for path in (prior_file, model_file) if path is not None]
    require_target(out, "calibration", inputs=[*paths, *known])
    if len(known) > 1:
        raise click.UsageError("expected one of --prior and --model, for each is what is known before; got both")
    if preload_n is not None and model_file is None:
        raise click.UsageError("--preload-n goes with --model; measurements that are fitted state their own preload_n")
    data = data_of(paths, map_path, takes=(DataKind.MODAL_TABLE, DataKind.SESSION))
    _require_options_of(data, excitation_source, band_hz)
    mass = None if moving_mass_kg is None else Estimate(*moving_mass_kg)
    prior = (
        None
        if prior_file is None
        else prior_from_calibration(read_calibration(calibration_at(prior_file)), prior_file.name)
    )
    remarks: list[str] = []
    if model_file is not None:
        calibration = _from_model(data, model_file, preload_n, weighting, mass, band_hz, excitation_source)
    elif data.is_session:
        calibration, remarks = _from_session(data, weighting, mass, band_hz, prior)
    else:
        source = None if excitation_source is None else ExcitationSource(excitation_source)
        calibration = _from_table(data.file, weighting, mass, source, prior)
    if out is not None:
        write_calibration(out, calibration)
    if as_json:
        print_json({**calibration_document(calibration), "warnings": remarks})
    else:
        _print(data, calibration)
        for remark in remarks:
            print_line(f"- {remark}.")


def _require_options_of(data: Data, excitation_source: str | None, band_hz: tuple[float, float] | None) -> None:
    """Refuse options that say nothing of this kind of data: they would be passed over in silence."""
    if data.is_session and excitation_source is not None:
        raise click.UsageError(f"--excitation-source goes with a modal table; the session {data.name} states its own")
    if not data.is_session and band_hz is not None:
        raise click.UsageError(f"--band-hz goes with a session; got {data.name}")


def _from_session(
    data: Data,
    weighting: str | None,
    mass: Estimate | None,
    band_hz: tuple[float, float] | None,
    prior: CoefficientPrior | None,
) -> tuple[Calibration, list[str]]:
    """Return the calibration, and what is said of the measurements it rests on."""
    settings = axis_settings(band_hz, mass)
    with opened_session(data) as session:
        judged = list(judge_session(session, settings))
    calibration = calibrate_judged(judged, settings, weighting=Weighting(weighting or Weighting.NONE), prior=prior)
    remarks = excitation_remarks([item for item in judged if item.conditions.preload is not None])
    return calibration, [f"{name}: {remark}" for name, remark in remarks.items()]


def _from_table(
    path: Path,
    weighting: str | None,
    mass: Estimate | None,
    source: ExcitationSource | None,
    prior: CoefficientPrior | None,
) -> Calibration:
    return _fitted([row.reading for row in read_modal_table(path)], weighting, mass, source, prior)


def _fitted(
    readings: Sequence[ModalReading],
    weighting: str | None,
    mass: Estimate | None,
    source: ExcitationSource | None,
    prior: CoefficientPrior | None,
) -> Calibration:
    stated = all(reading.frequency_std is not None for reading in readings)
    chosen = Weighting(weighting) if weighting else (Weighting.STD if stated else Weighting.NONE)
    return fit_calibration(readings, weighting=chosen, excitation_source=source, moving_mass=mass, prior=prior)


def _from_model(
    data: Data,
    model_file: Path,
    preload_n: tuple[float, float] | None,
    weighting: str | None,
    mass: Estimate | None,
    band_hz: tuple[float, float] | None,
    excitation_source: str | None,
) -> Calibration:
    """Join what a drive model lets expect with measurements, of preloads that were set, or of one that nobody set."""
    # models take a second to import
    from monitor_core.identification import prior_of_drive, usual_preload_of  # noqa: PLC0415
    from monitor_core.recordings.model_file import read_model_file  # noqa: PLC0415
    from service.cli.inputs.model import model_at  # noqa: PLC0415

    axis, settings = read_model_file(model_at(model_file)), axis_settings(band_hz, mass)
    of_nut = usual_preload_of(axis) if preload_n is None else log_preload(Estimate(*preload_n))
    if data.is_session:
        with opened_session(data) as session:
            outcomes = [item.outcome.modal for item in judge_session(session, settings)]
        modes = [modal for modal in outcomes if isinstance(modal, ModalMeasurement)]
        if not modes:
            raise NotIdentifiableError("a calibration of a drive model needs a judged measurement; got none")
        prior = prior_of_drive(axis, modes[0].excitation_source)
        chosen = Weighting(weighting or Weighting.NONE)
        return calibrate_by_drive(modes, prior, of_nut, settings=settings, weighting=chosen)
    rows = [row.reading for row in read_modal_table(data.file)]
    unset = [row for row in rows if row.conditions.preload is None]
    source = ExcitationSource(excitation_source or ExcitationSource.SENSOR)
    prior = prior_of_drive(axis, source)
    if unset:
        prior = with_unset_preload(prior, unset, of_nut)
    if len(unset) == len(rows):
        return calibration_from_prior(prior, moving_mass=mass)
    return _fitted([row for row in rows if row.conditions.preload is not None], weighting, mass, source, prior)


def _print(data: Data, calibration: Calibration) -> None:
    coefficients = zip(COEFFICIENT_KEYS.values(), calibration.parameters.values, strict=False)
    residuals = "none: no preload was set"
    if calibration.residual_rms is not None and calibration.residual_max is not None:
        residuals = f"{calibration.residual_rms:.4f} / {calibration.residual_max:.4f} Hz"
    print_table(
        f"Calibration from {data.name} ({calibration.n_readings} readings, weighting {calibration.weighting})",
        ("quantity", "value"),
        [
            *((name, f"{value:.6g}") for name, value in coefficients),
            ("residual, rms / max", residuals),
            ("reproducibility", f"{calibration.reproducibility:.4f} Hz"),
            ("condition number", f"{calibration.condition_number:.1f}"),
            ("minimum detectable loss", f"{minimum_detectable_loss(calibration):.0f} N"),
            ("prior", calibration.prior or "none"),
        ],
    )
