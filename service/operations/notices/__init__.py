"""Tell receivers outside of alarms: what is told, who is told, and until when it is tried again."""
