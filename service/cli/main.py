"""Entry point of ``preload``: exit 0 done, 2 bad input (one line on standard error), 1 anything else."""

import gc
import sys
from difflib import get_close_matches
from importlib import import_module

import click
from pydantic import ValidationError

from monitor_core.errors import MonitorCoreError
from service.blas_threads import compute_in_one_thread
from service.errors import ServiceError, first_refusal

#: What each command does. Each is in a module of its name, imported when it is asked for: most need neither web nor
#: database, and the list of commands needs none of them.
COMMANDS = {
    "backup": "Copy the data folder while the service runs, verified.",
    "batch": "Run many computing commands, by several workers or by Dask.",
    "calibrate": "Fit k1…k4 to natural frequencies at several positions and preloads.",
    "check": "Say what is in a file, who can use it, and what to do next with it.",
    "demo": "Replay the bundled sessions through an embedded service.",
    "estimate": "Turn natural frequencies or a recorded session into preload.",
    "explain": "Find which effect a model lacks, add it, and show the gap shrink.",
    "frf": "Find the axial mode in each measurement of a recorded session.",
    "import": "Make a session, a motion record or an FRF set of raw files.",
    "identify": "Find the joints of an axis from peaks, responses or a session.",
    "key": "Make and revoke the keys of programs.",
    "lost-motion": "Measure what an axis loses where it turns back, and which part is play.",
    "modes": "List the modes of a drive model.",
    "mqtt": "Take windows from an MQTT broker to a service.",
    "opcua": "Show preload, state and alarms of a service to OPC UA clients.",
    "rejudge": "Judge the history of an axis anew under another calibration.",
    "replay": "Post a recorded session to a service.",
    "restore": "Verify a backup and make a data folder of it.",
    "retention": "Say how long waveforms are kept and what they take; let go what the rule does not keep.",
    "serve": "Run the service.",
    "simulate": "Record a session of a drive model, without a machine.",
    "torque": "Read friction and the orders of the screw from torque and position alone.",
    "user": "Make and change the people who may log in.",
}

#: Commands by what a person comes for.
GROUPS = {
    "Measure": ("check", "import", "frf", "calibrate", "estimate", "torque", "lost-motion"),
    "Model and explain": ("modes", "simulate", "identify", "explain", "batch"),
    "Run the service": ("demo", "serve", "replay", "rejudge", "mqtt", "opcua"),
    "Administer": ("backup", "restore", "retention", "user", "key"),
}
#: The help of each command ends with one.
EXAMPLES = {
    "backup": "backup /mnt/backup/monday",
    "batch": "batch hall-3.txt --out answers --workers 2",
    "calibrate": "calibrate april.session.h5 --band-hz 140 230 --out axis.json",
    "check": "check day-01.tdms --write-map mill.toml",
    "demo": "demo --stay",
    "estimate": "estimate march.session.h5 --calibration axis.json",
    "explain": "explain april.session.h5 --baseline mill.toml --report why",
    "frf": "frf march.session.h5 --band-hz 140 230",
    "identify": "identify april.session.h5 --model mill.toml --out found.toml",
    "import": "import day-01.tdms day-02.tdms --map mill.toml --out march.session.h5",
    "key": "key add press-3 --scope windows:write",
    "lost-motion": "lost-motion reversals.session.h5",
    "modes": "modes mill.toml --position-mm 250 500 750",
    "mqtt": "mqtt --url 127.0.0.1:8710",
    "opcua": "opcua --url 127.0.0.1:8710",
    "rejudge": "rejudge --url 127.0.0.1:8710 --axis X --calibration 2 --dry-run",
    "replay": "replay march.session.h5 --url 127.0.0.1:8710 --axis X",
    "restore": "restore /mnt/backup/monday --data-dir var",
    "retention": "retention show --days 365",
    "serve": "serve --data-dir /var/lib/preload",
    "simulate": "simulate mill.toml --out trial.session.h5",
    "torque": "torque strokes.session.h5 --lead-mm 10 --out strokes.svg",
    "user": "user add anna --role operator",
}
#: Where a command stands that has no module of its own.
MODULES = {
    "restore": "backup", "import": "import_raw", "key": "people", "user": "people", "lost-motion": "lost_motion",
}  # fmt: skip
#: How its function is called where a keyword of the language has its name.
FUNCTIONS = {"import": "import_raw", "lost-motion": "lost_motion"}

#: Objects that may have come, beyond those that went, before the collector looks for rings of them. To import makes
#: many and hardly a ring, as does a request: to look after every 700, as is usual, takes an eighth of the start of the
#: service, and a fortieth of the time of a window.
COLLECTED_EVERY = 20_000

#: Commands whose imports take longer than a person waits without a sign.
_SLOW_TO_START = ("explain", "identify")


def command_named(name: str) -> click.Command:
    """Import a command."""
    command: click.Command = getattr(import_module(f"service.cli.{MODULES.get(name, name)}"), FUNCTIONS.get(name, name))
    command.epilog = f"\b\nExample: preload {EXAMPLES[name]}"
    return command


class _Commands(click.Group):
    """Commands that are imported one by one."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        del ctx
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, None where there is none of this name."""
        if cmd_name in _SLOW_TO_START and sys.stderr.isatty():
            click.echo(f"preload {cmd_name}: starting", err=True)
        if cmd_name in COMMANDS:
            return command_named(cmd_name)
        if like := get_close_matches(cmd_name, COMMANDS, n=1):
            ctx.fail(f"No such command '{cmd_name}'. Did you mean '{like[0]}'?")
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        del ctx
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, COMMANDS[name]) for name in names])


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="preload-monitor", prog_name="preload")
def preload() -> None:
    """Ball-screw preload in newtons from motor torque and nut acceleration."""


def main() -> None:
    """Run the command line."""
    gc.set_threshold(COLLECTED_EVERY)
    compute_in_one_thread()  # before a command imports numpy
    try:
        sys.exit(preload.main(standalone_mode=False) or 0)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        sys.exit(2)
    except click.ClickException as error:
        _refuse(error.format_message())
    except (MonitorCoreError, ServiceError, OSError) as error:
        _refuse(str(error))
    except ValidationError as error:  # only Settings are validated on this side
        _refuse(f"setting {first_refusal(error)}")
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped", err=True)
        sys.exit(1)


def _refuse(message: str) -> None:
    from service.cli.output import print_line  # noqa: PLC0415  # most commands end well, and `preload --help` at once

    print_line("preload: " + " ".join(message.split()), err=True)
    sys.exit(2)


if __name__ == "__main__":
    main()
