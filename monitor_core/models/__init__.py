"""Four published models of a ball-screw drive behind one protocol: where the modes should be, and why."""
