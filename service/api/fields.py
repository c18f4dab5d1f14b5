"""Fields that several wire models and routes share: texts and identifiers."""

from typing import Annotated

from fastapi import Path
from pydantic import BaseModel, ConfigDict, Field

#: No control characters: PostgreSQL stores no NUL, and a name with a line break is a slip.
Label = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Text = Annotated[str, Field(min_length=1, max_length=1000, pattern=r"^[^\x00]+$")]

AxisName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
AxisId = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", description="letters, digits, dot, dash, underscore")
]
RowId = Annotated[int, Path(ge=1, lt=2**63)]
JobId = Annotated[str, Path(pattern=r"^[0-9a-f-]{36}$")]


class RequestModel(BaseModel):
    """Base of everything that a client sends: unknown members are refused, and nothing is changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True)
