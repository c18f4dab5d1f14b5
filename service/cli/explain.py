"""``preload explain DATA --baseline MODEL``: what a model lacks, and how far adding it closes the gap."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from monitor_core.discrepancy import ExplainOptions, Explanation, Measured, explain as explain_axis
from monitor_core.effects import Effect
from monitor_core.errors import RecordingFormatError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.recording import MotionRecord
from monitor_core.recordings.effect_file import effect_file_text, read_effect_file
from monitor_core.recordings.elements.units import metres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import model_file_text, read_model_file
from service.cli.inputs.data import (
    Data,
    DataKind,
    axis_settings,
    band_option,
    data_argument,
    data_of,
    frf_set_of,
    map_option,
    motion_of,
)
from service.cli.inputs.model import (
    NumbersCommand,
    accelerometer_option,
    model_at,
    require_session,
    responses_of_data,
    tolerance_option,
    tolerances_of,
)
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.targets import require_target, require_target_folder
from service.documents.explanation import explanation_document
from service.report.content import Cell, EffectContent, ReportContent, report_content
from service.report.explanation_files import write_report

#: How many places of misfit, and how many effects that were not found, a person is shown; the report has all.
_MOST_PLACES, _MOST_CANDIDATES = 3, 5
#: How long it may take; see benchmarks.explain_speed.
_USUALLY = "some seconds to two minutes"


@click.command(cls=NumbersCommand)
@data_argument
@map_option
@click.option(
    "--baseline", "baseline_path", type=click.Path(path_type=Path), required=True,
    help="Drive model, TOML: what the axis is said to be. What a fit may adjust stands in its [uncertain].",
)  # fmt: skip
@click.option(
    "--report", "report_dir", type=click.Path(path_type=Path, file_okay=False), metavar="DIR",
    help="Write the report into this folder: a page of HTML, Markdown, JSON and the augmented model.",
)  # fmt: skip
@click.option(
    "--hold-out-mm", "hold_out_mm", type=float, multiple=True, metavar="X…",
    help="Positions that the fit does not see and is judged by; without any, two inner ones of five or more, else each "
    "of four preloads or more in turn. Of a motion it is always the second half.",
)  # fmt: skip
@click.option(
    "--effects", "effects_path", type=click.Path(path_type=Path), metavar="FILE",
    help="Python file that defines EFFECTS, of your own, besides those of the product. It is run.",
)  # fmt: skip
@click.option(
    "--healthy", "healthy_paths", type=click.Path(path_type=Path, exists=True), multiple=True, metavar="DATA",
    help="Responses of a machine of the same type that lacks nothing, a file, or a folder with one for each (*.h5): "
    "what the model is wrong in on those is no finding. May be given several times.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), metavar="MODEL",
    help="Write the augmented model: what was refitted, and the effects that were found. Where something was described "
    "that has no name, its law goes into a file of the same name with .effects.py, for --effects.",
)  # fmt: skip
@click.option(
    "--time-limit", "time_limit_s", type=click.FloatRange(min=0.0, min_open=True), metavar="SECONDS",
    help="Give the best answer so far after this time: partial or unknown, with what was not tried. What the model "
    "leaves as it stands is found in any case. Without it the search takes as long as it takes.",
)  # fmt: skip
@tolerance_option
@accelerometer_option
@band_option
@json_option
def explain(
    paths: tuple[Path, ...],
    map_path: Path | None,
    baseline_path: Path,
    report_dir: Path | None,
    hold_out_mm: tuple[float, ...],
    effects_path: Path | None,
    healthy_paths: tuple[Path, ...],
    out: Path | None,
    time_limit_s: float | None,
    tolerances: tuple[tuple[str, float], ...],
    accelerometer: str | None,
    band_hz: tuple[float, float] | None,
    as_json: bool,
) -> None:
    """Find where measurements and a model part, name what is missing, add it, and show the gap shrink.

    DATA is a set of frequency responses, a session, a modal table, a motion record, or with --map raw files of one.
    """
    began = time.monotonic()
    inputs = [*paths, *healthy_paths, *([] if effects_path is None else [effects_path])]
    require_target(out, "model file", inputs=inputs)
    require_target_folder(report_dir)
    data = data_of(paths, map_path, takes=tuple(DataKind))
    healthy_files = tuple(_files(healthy_paths))
    if {path.resolve() for path in healthy_files} & {path.resolve() for path in paths}:
        raise click.UsageError(f"--healthy takes machines that lack nothing; {data.name} is the one to explain")
    baseline = read_model_file(model_at(baseline_path))
    effects = () if effects_path is None else read_effect_file(effects_path)
    _require_writable(baseline, effects)
    setting_tolerances = tolerances_of(data, tolerances)
    with _watched(data.name) as progress:
        progress("reading")
        measured, assumptions = _measured(data, band_hz, accelerometer)
        options = ExplainOptions(
            hold_out=tuple(metres(position) for position in hold_out_mm),
            effects=effects,
            healthy=tuple(_responses(path, band_hz) for path in healthy_files),
            accelerometer=accelerometer,
            assumptions=assumptions,
            tolerances=setting_tolerances,
        )
        explanation = explain_axis(
            baseline,
            measured,
            options,
            progress=progress,
            time_is_up=lambda: time_limit_s is not None and time.monotonic() - began >= time_limit_s,
        )
    model_text = model_file_text(explanation.augmented or baseline)
    if report_dir is not None:
        write_report(report_dir, explanation, model_text, _subject(data, baseline_path, len(options.healthy)))
    if out is not None:
        out.write_text(model_text, encoding="utf-8")
        if own := _own_effects(explanation):
            _effects_beside(out).write_text(effect_file_text(own), encoding="utf-8")
    if as_json:
        print_json(explanation_document(explanation, model_text))
    else:
        _print(report_content(explanation))
        for path in _written(report_dir, out, described=bool(_own_effects(explanation))):
            print_line(f"Written: {path}")


def _require_writable(baseline: AxisDescription, effects: tuple[Effect[Any], ...]) -> None:
    """Refuse effects with names that no model file could hold: before the search, not after it."""
    model_file_text(replace(baseline, effects={effect.key: effect.null_values() for effect in effects}))


def _subject(data: Data, baseline: Path, n_healthy: int) -> str:
    machines = "machine" if n_healthy == 1 else "machines"
    learnt = f", beyond what {n_healthy} healthy {machines} of its type show" if n_healthy else ""
    return f"{data.name} against {baseline.name}{learnt}"


def _own_effects(explanation: Explanation) -> tuple[Effect[Any], ...]:
    """Return what was described as effects that the product does not know."""
    return tuple(effect for description in explanation.described for effect in description.effects)


def _effects_beside(model: Path) -> Path:
    """Return where the effects go that a model states and the product does not know; ``--effects`` takes the file."""
    return model.with_suffix(".effects.py")


def _written(report_dir: Path | None, out: Path | None, *, described: bool) -> Iterator[Path]:
    if report_dir is not None:
        yield report_dir / "explanation.html"
    if out is not None:
        yield out
        if described:
            yield _effects_beside(out)


def _measured(
    data: Data, band_hz: tuple[float, float] | None, accelerometer: str | None
) -> tuple[Measured, tuple[str, ...]]:
    """Return what was measured, and what was settled on the way, in sentences."""
    require_session(accelerometer, of_session=data.is_session)
    if band_hz is not None and not data.is_session:
        raise click.UsageError(f"--band-hz goes with a session; got {data.name}")
    match data.kind:
        case DataKind.FRF_SET:
            return frf_set_of(data).observations, ()
        case DataKind.SESSION:
            session = responses_of_data(data, axis_settings(band_hz))
            return session.observations, session.sentences
        case DataKind.MOTION:
            return motion_of(data), ()
        case DataKind.MODAL_TABLE:
            return tuple(row.observation for row in read_modal_table(data.file)), ()


def _files(paths: Iterable[Path]) -> Iterator[Path]:
    for path in paths:
        files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
        if not files:
            raise RecordingFormatError(f"--healthy {path.name}: expected files of responses, *.h5; got none")
        yield from files


def _responses(path: Path, band_hz: tuple[float, float] | None) -> tuple[FrequencyResponseObservation, ...]:
    """Return the responses of one machine."""
    measured, _ = _measured(data_of((path,), None, takes=tuple(DataKind)), band_hz, None)
    several = () if isinstance(measured, MotionRecord) else measured
    responses = tuple(observation for observation in several if isinstance(observation, FrequencyResponseObservation))
    if not responses:
        raise RecordingFormatError(f"--healthy {path.name}: expected a set of frequency responses or a session")
    return responses


@contextmanager
def _watched(name: str) -> Iterator[Callable[[str], None]]:
    with progress_bar(of_unknown_length=True) as bar:
        task = bar.add_task(f"{name}, {_USUALLY}", total=None)
        yield lambda sentence: bar.update(task, description=f"{name}, {_USUALLY}: {sentence}", advance=1)


def _print(content: ReportContent) -> None:
    print_line(content.headline)
    for aside in content.asides:
        print_line(aside)
    if content.misfits:
        rows = [_texts(row[:3]) for row in content.misfits[:_MOST_PLACES]]
        print_table(content.misfits_heading, ("where", "misfit, rms", "looks like"), rows)
    if content.effects:
        print_table(
            content.found_heading,
            ("effect", "evidence (ΔBIC)", "parameter", "value", "95 % interval", "plausible"),
            [row for effect in content.effects for row in _found_rows(effect)],
        )
    for effect in content.effects:
        for remark in effect.remarks:
            print_line(f"- {effect.name}: {remark}.")
    print_table("Gap", ("", "fitted data", "held-out data", "noise floor"), [_texts(row) for row in content.gap])
    for number, step in enumerate(content.steps, start=1):
        print_line(f"{number}. {step}")
    candidates = content.candidates[:_MOST_CANDIDATES]
    more = len(content.candidates) - len(candidates)
    if candidates:
        print_table(
            content.candidates_heading,
            ("effect", "evidence (ΔBIC)", "tried", "detection limit"),
            [_texts((*row[:3], row[4])) for row in candidates],
        )
        print_line(content.threshold)
    if more:
        print_line(f"{more} more: --report DIR or --json lists them.")
    if content.next_steps:
        print_line("Measure next:")
    for step in content.next_steps:
        print_line(f"- {step}.")


def _found_rows(content: EffectContent) -> Iterator[tuple[str, ...]]:
    effect = " or ".join((content.name, *content.others))
    for row in content.parameters:
        yield effect, str(content.delta_bic), *_texts(row)


def _texts(row: Iterable[Cell]) -> tuple[str, ...]:
    return tuple(str(cell) for cell in row)
