"""Name many moments by one parameter: a statement with one for each takes longer to write than to answer."""

import json
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import ARRAY, BigInteger, ColumnElement, Select, any_, bindparam, func, select, type_coerce

from service.store.prepared import PreparedSelect


def at_moments(query: Select[Any], at: ColumnElement[datetime]) -> dict[str, PreparedSelect]:
    """Return a query for the rows of the parameter ``moments``, by database.

    They are an array, or on SQLite, which has none, a text in JSON.
    """
    counted = type_coerce(at, BigInteger)
    array = bindparam("moments", type_=ARRAY(BigInteger))
    listed = select(func.json_each(bindparam("moments")).table_valued("value").c.value)
    return {
        "postgresql": PreparedSelect(query.where(counted == any_(array))),
        "sqlite": PreparedSelect(query.where(counted.in_(listed))),
    }


def named(moments: Sequence[int], dialect: str) -> Sequence[int] | str:
    """Return moments, in microseconds since 1970, as the parameter holds them."""
    return json.dumps(moments) if dialect == "sqlite" else moments
