"""Write the report of an explanation into a folder: JSON, Markdown, a page of HTML, and the model."""

import json
from pathlib import Path

from monitor_core.discrepancy import Explanation
from service.documents.explanation import explanation_document
from service.report.markdown import explanation_markdown
from service.report.page import explanation_page


def write_report(directory: Path, explanation: Explanation, model_text: str, subject: str) -> tuple[Path, ...]:
    """Write ``explanation.json``, ``explanation.md``, ``explanation.html`` and ``model.toml``; return their paths.

    The directory is made if it is not there; files of an earlier report are replaced.
    """
    document = explanation_document(explanation, model_text)
    contents = {
        "explanation.json": json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n",
        "explanation.md": explanation_markdown(explanation, model_text, subject),
        "explanation.html": explanation_page(explanation, model_text, subject),
        "model.toml": model_text,
    }
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in contents.items():
        (directory / name).write_text(text, encoding="utf-8")
    return tuple(directory / name for name in contents)
