"""Store the trend of an axis: points, what hours and days of them hold, and where the charts stood."""
