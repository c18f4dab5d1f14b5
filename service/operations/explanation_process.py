"""An explanation in a process of its own: a search would keep the interpreter from everything that comes in meanwhile.

The process can be stopped at any moment, so that a cancelled search does not hold up the next one.
"""

import multiprocessing
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from threadpoolctl import threadpool_limits

from service.operations.explanation import ExplanationRequest, explain_measurements
from service.operations.explanation_document import explanation_document
from service.operations.explanation_report import explanation_page

#: How often whoever waits is told that it still goes on, and may stop it.
TOLD_EVERY_S = 0.5


@dataclass(frozen=True, slots=True)
class Explained:
    """An explanation as it is stored."""

    document: dict[str, Any]  # the JSON of ``preload explain``
    page: str  # the report, one self-contained page of HTML


def explained(request: ExplanationRequest, subject: str, tell: Callable[[str], None]) -> Explained:
    """Explain measurements beside this process.

    Parameters
    ----------
    request : ExplanationRequest
    subject : str
        What was compared with what, as the title of the report says it.
    tell : callable
        Told twice a second what is being done; what it raises stops the process.

    Raises
    ------
    MonitorCoreError
        As :func:`service.operations.explanation.explain_measurements`.
    """
    spawn = multiprocessing.get_context("spawn")
    receiver, sender = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_explain, args=(sender, request, subject), daemon=True)
    process.start()
    sender.close()  # so that the end of the process is the end of what can be received
    try:
        return _answer(receiver, tell)
    except EOFError as error:
        process.join()
        raise RuntimeError(f"the process of the search ended by itself, exit code {process.exitcode}") from error
    finally:
        process.terminate()
        process.join()
        receiver.close()


def _answer(receiver: Connection, tell: Callable[[str], None]) -> Explained:
    """Pass on what is being done until the answer comes, or the refusal."""
    sentence = "reading what was measured"
    while True:
        tell(sentence)
        while receiver.poll(TOLD_EVERY_S):
            match receiver.recv():
                case str(sentence):
                    tell(sentence)
                case Explained() as answer:
                    return answer
                case Exception() as error:
                    raise error


def _explain(sender: Connection, request: ExplanationRequest, subject: str) -> None:
    """Work in the process, and say what is being done, last the answer."""
    threadpool_limits(1)
    answer: Explained | Exception
    try:
        explanation, model_text = explain_measurements(request, sender.send)
        answer = Explained(
            explanation_document(explanation, model_text), explanation_page(explanation, model_text, subject)
        )
    except Exception as error:  # noqa: BLE001 the edge of this process: who started it is told whatever broke
        error.add_note(traceback.format_exc())
        answer = error
    sender.send(answer)
