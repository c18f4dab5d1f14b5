"""Try the service without a machine: a simulated axis with a year behind it, through the ordinary operations."""
