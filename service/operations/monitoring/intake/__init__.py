"""Take windows in: to which measurement they belong, what is judged, and in which order the charts see it."""
