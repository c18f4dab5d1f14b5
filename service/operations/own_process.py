"""Long work in a process of its own: it would keep the interpreter from everything that comes in meanwhile.

The process can be stopped at any moment, so that cancelled work does not hold up the next.
"""

import multiprocessing
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TypeVar, cast

from threadpoolctl import threadpool_limits

Answer = TypeVar("Answer")
#: Says in a few words what is being done.
Tell = Callable[[str], None]

#: How often whoever waits is told that it still goes on, and may stop it.
TOLD_EVERY_S = 0.5


def in_own_process(work: Callable[[Tell], Answer], tell: Tell) -> Answer:
    """Do work beside this process.

    Parameters
    ----------
    work : callable
        Can be pickled, as can what it returns, which is no text; is handed what it may say its progress to.
    tell : callable
        Told twice a second what is being done; what it raises stops the process.

    Raises
    ------
    Exception
        What the work raises.
    RuntimeError
        If the process ends without an answer.
    """
    spawn = multiprocessing.get_context("spawn")
    receiver, sender = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_do, args=(sender, work), daemon=True)
    process.start()
    sender.close()  # so that the end of the process is the end of what can be received
    try:
        return cast(Answer, _answer(receiver, tell))
    except EOFError as error:
        process.join()
        raise RuntimeError(f"the process of the search ended by itself, exit code {process.exitcode}") from error
    finally:
        process.terminate()
        process.join()
        receiver.close()


def _answer(receiver: Connection, tell: Tell) -> object:
    """Pass on what is being done until the answer comes, or the refusal."""
    sentence = "reading what was measured"
    while True:
        tell(sentence)
        while receiver.poll(TOLD_EVERY_S):
            match receiver.recv():
                case str(sentence):
                    tell(sentence)
                case Exception() as error:
                    raise error
                case answer:
                    return answer


def _do(sender: Connection, work: Callable[[Tell], object]) -> None:
    """Work in the process, and say what is being done, last the answer."""
    threadpool_limits(1)
    answer: object
    try:
        answer = work(sender.send)
    except Exception as error:  # noqa: BLE001 the edge of this process: who started it is told whatever broke
        error.add_note(traceback.format_exc())
        answer = error
    sender.send(answer)
