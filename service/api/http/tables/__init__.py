"""Answer every list as a table, CSV or Parquet: one mechanism for all routes, now and later."""
