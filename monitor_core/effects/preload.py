"""How the rigidity of the nut follows its preload, and what the preload really is."""

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, having, increasing
from monitor_core.effects.sizes import Reference

PRELOAD_EXPONENT = Effect(
    key="preload-exponent",
    name="Exponent of the preload",
    physics=(
        "The rigidity of the nut grows as preload^(1/3 + change), which Hertz's contact alone would make the "
        "cube root; at 10 % of the dynamic load rating it is unchanged."
    ),
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(EffectParameter("exponent_change", "-", lower=-1.0 / 3.0, upper=2.0 / 3.0, scale=0.1),),
    add=increasing("added", preload_exponent_change="exponent_change"),
    needs=frozenset({ConditionAxis.PRELOAD}),
    applies=having("joints", "dynamic_load_rating"),
)


PERIODIC_PRELOAD = Effect(
    key="periodic-preload",
    name="Preload that varies over the lead",
    physics=(
        "Errors of the thread that repeat each turn make preload and nut rigidity vary with the position over "
        "one lead: preload (1 + a cos 2πx/lead + b sin 2πx/lead)."
    ),
    source="no source: first harmonic of an error that repeats each turn",
    parameters=(
        EffectParameter("cosine_amplitude", "-", lower=-0.5, upper=0.5, scale=0.1, beyond=False),
        EffectParameter("sine_amplitude", "-", lower=-0.5, upper=0.5, scale=0.1, beyond=False),
    ),
    add=increasing("added", periodic_preload_cosine="cosine_amplitude", periodic_preload_sine="sine_amplitude"),
    needs=frozenset({ConditionAxis.POSITION}),
)


PRELOAD_CHANGE = Effect(
    key="preload-change",
    name="Change of the nut's preload",
    physics=(
        "Balls and raceways wear, and the nut is pressed together by less than was set: its contacts soften with the "
        "cube root of the preload. Frequencies fall a little, more at the stiff end of the screw; the antiresonance of "
        "the nut, which masses and bracket make, stays."
    ),
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(
        # a nut that has lost all of it has play, and no rigidity that a preload gives
        EffectParameter("preload_n", "N", lower=-0.98, upper=1.0, scale=0.1, reference=Reference.PRELOAD),
    ),
    add=increasing("added", preload_change="preload_n"),
    applies=having("joints", "dynamic_load_rating"),
)
