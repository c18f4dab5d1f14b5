"""Keep what is stored from everybody else on the machine, whatever the umask of the process was."""

import os
import stat
from pathlib import Path

from service.errors import StorageError

_RIGHTS_OF_OTHERS = 0o077


def private_folder(folder: Path) -> None:
    """Make a folder where there is none, and let nobody but its owner in; what this process makes is its owner's alone.

    That is said to the process once, as SQLite, the frames, the uploads and the processes of jobs all go by its umask.
    In a folder of another owner the umask stays as it was: that one reads what is written there. Raises StorageError.
    """
    umask = os.umask(_RIGHTS_OF_OTHERS)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if folder.stat().st_uid != os.geteuid():
            os.umask(umask)
        close_to_others(folder)
    except OSError as error:
        raise StorageError(f"the data folder {folder} cannot be made: {error.strerror}") from error


def close_to_others(path: Path) -> None:
    """Take the rights of everybody else at a file or folder; one of another owner stays as that one has it."""
    status = path.stat()
    if status.st_uid == os.geteuid() and status.st_mode & _RIGHTS_OF_OTHERS:
        path.chmod(stat.S_IMODE(status.st_mode) & ~_RIGHTS_OF_OTHERS)
