"""The bench: described axes, observations, residuals, fits and their evidence.

Identifying and explaining stand on it: what an axis is said to be (``axis``), what was observed of it
(``observations``), what differs (``residuals``, ``conditions``), what may be adjusted (``problem``, ``coordinates``,
``hypothesis``), the one fit (``solver``), and what the fit is evidence of (``evidence``, ``hold_out``).
"""
