"""Joint parameters from measurements: what the data determine, how well, and what they do not see.

``observations`` says what was measured, ``assignment`` which mode a peak belongs to; ``modal_problem`` and
``response_problem`` compare them with a drive of distributed screw; ``search`` and ``fit`` find the joints,
``identifiability`` and ``profiles`` say how well; ``sensitivity`` and ``planning`` which mode and which position help.
"""
