"""Losses of the drive: damping of the joints, friction of the guides."""

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, increasing
from monitor_core.effects.sizes import Reference

LOSS_FACTOR = Effect(
    key="loss-factor",
    name="Loss factor of the joints",
    physics=(
        "Every spring of a joint loses a share of its energy in each cycle, at any frequency. Peaks become lower "
        "and wider; natural frequencies hardly move. Springs stiffen a little with frequency."
    ),
    source="Sun et al. (2022), section 3: k (1 + jη); Kjartansson (1979) for what causality adds",
    parameters=(EffectParameter("loss_factor", "-", lower=0.0, upper=0.5, scale=0.02),),
    add=increasing("joints", causal_loss_factor="loss_factor"),
    form_share=0.05,
)

GUIDE_FRICTION = Effect(
    key="guide-friction",
    name="Coulomb friction of the guides",
    physics=(
        "A force of constant size opposes the motion of the table. It damps weak excitation more than strong "
        "excitation; the response depends on the level."
    ),
    source="Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5",
    parameters=(
        EffectParameter("friction_n", "N", lower=0.0, upper=3.2, scale=0.032, reference=Reference.EXCITATION_FORCE),
    ),
    add=increasing("added", guide_friction="friction_n"),
    form_share=0.03,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)
