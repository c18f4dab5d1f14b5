"""Keep the name by which effect files of users import ``Effect``: they were written before it moved to ``effects``."""

from monitor_core.effects import Effect, EffectParameter

__all__ = ["Effect", "EffectParameter"]
