"""Send notices of alarms and states to receivers outside."""
