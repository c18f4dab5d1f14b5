"""``preload import RAW… --map MAP --out FILE``: a session, a motion record or an FRF set of raw files."""

from pathlib import Path

import click

from monitor_core.recordings.frf_set import write_frf_set
from monitor_core.recordings.motion_csv import write_motion_record
from monitor_core.recordings.raw.mapping.imported import ImportedMotion, ImportedSession
from monitor_core.recordings.raw.mapping.imported_frf import ImportedFrfSet
from monitor_core.recordings.session_hdf5 import write_session
from service.cli.inputs.data import SESSION_SUFFIXES, DataKind, Imported, data_of, import_of, say
from service.cli.options import force_option, json_option
from service.cli.output import print_json, print_line
from service.cli.targets import require_target
from service.json_types import JsonObject

_TARGETS = {DataKind.SESSION: "session file", DataKind.FRF_SET: "session file", DataKind.MOTION: "table"}


@click.command("import")
@click.argument("paths", metavar="RAW…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--map", "map_path", required=True, type=click.Path(path_type=Path), metavar="MAP",
    help="Channel map, TOML: says what the channels of the raw files mean.",
)  # fmt: skip
@click.option(
    "--out", required=True, type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="Session (*.session.h5), set of frequency responses (*.frf.h5) or motion record (*.csv).",
)  # fmt: skip
@force_option
@json_option
def import_raw(paths: tuple[Path, ...], map_path: Path, out: Path, force: bool, as_json: bool) -> None:
    """Make a session, a motion record or a set of frequency responses of raw files.

    RAW are files of other programs (CSV, TDMS, UFF58, MAT, NPZ, …), several into one.
    """
    kind = _kind_of(out)
    require_target(out, _TARGETS[kind], inputs=[*paths, map_path])
    if out.exists() and not force:
        raise click.UsageError(f"{out} already exists; --force replaces it")
    data = data_of(paths, map_path, takes=tuple(DataKind))
    if data.kind is not kind:
        raise click.UsageError(f"{map_path.name} makes a {data.kind} of raw files; {out.name} would be a {kind}")
    imported = import_of(data)
    document = _write(out, imported)
    if as_json:
        print_json(document)
        return
    say(imported)
    counts = ", ".join(
        f"{document[name]} {name}" for name in ("windows", "conditions", "samples") if document.get(name)
    )
    print_line(f"Written: {out} ({counts})")


def _kind_of(out: Path) -> DataKind:
    name = out.name.lower()
    if name.endswith(".frf.h5"):
        return DataKind.FRF_SET
    if name.endswith(SESSION_SUFFIXES):
        return DataKind.SESSION
    if name.endswith(".csv"):
        return DataKind.MOTION
    raise click.BadParameter(
        f"--out ends in .session.h5 (session), .frf.h5 (set of frequency responses) or .csv (motion record); got "
        f"{out.name}"
    )


def _write(out: Path, imported: Imported) -> JsonObject:
    document: JsonObject = {"written": str(out), "windows": 0}
    match imported:
        case ImportedSession():
            write_session(out, imported.session, tolerances=imported.tolerances.attributes)
            document |= {"windows": len(imported.session.windows), "measurements": len(imported.session.measurements)}
        case ImportedFrfSet():
            write_frf_set(out, imported.responses, tolerances=imported.tolerances.attributes)
            document |= {"conditions": len(imported.responses.measured)}
        case ImportedMotion():
            write_motion_record(out, imported.record)
            document |= {"samples": int(imported.record.position.size)}
    left_out: list[JsonObject] = [{"what": left.what, "why": left.why} for left in imported.left_out]
    return document | {"left_out": left_out, "remarks": list(imported.remarks)}
