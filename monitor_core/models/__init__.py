"""Predict a ball-screw axis: the responses, natural frequencies and modes that its parameters imply.

A model is asked at :class:`DriveConditions`, driven at an :class:`ExcitationPoint`, and answers at a
:class:`ResponsePoint`. Each family of models exists twice, because it is asked two kinds of questions:

======================  ================================================================  ==========================
package                 what it is                                                        who asks it
======================  ================================================================  ==========================
``published/``          the equations of the four papers as they stand, corrected where   ``build_model``; ``preload
                        ``docs/reference/errata.md`` says so; the reference of            modes``, ``preload
                        equations and tests                                               simulate``, identification
``extended/``           one closed form for all families, to which effects can be added;  a model file that states
                        ``physics_of`` says how closely each family is met                ``[effects]``, ``preload
                                                                                          explain``, the causes of
                                                                                          alarms
``motion/``             a rigid axis: the motor force that its mass and friction need     the family ``motion``
``generator/``          recorded sessions of a model: moves, friction, sensors            ``preload simulate``
======================  ================================================================  ==========================

The four families, by their names in model files; :func:`monitor_core.models.families.build_model` builds each of them
from its name and its parameters (it is not imported here, because it loads all four):

=====================  =============================================================================================
``lumped``             T. L. Nguyen et al., J. Korean Soc. Precis. Eng., 2018: one spring, one moving mass
``hybrid``             X. Sun et al., J. Phys.: Conf. Ser. 2383 (2022) 012040: a screw in its static shape
``receptance``         F. Tian et al., Multi-Position Identification of Joint Parameters in Ball Screw Feed System
                       Based on Response Coupling: a continuous screw, joints as springs and dampers
``transmission-line``  V. Y. Moreno-Castaneda et al., LAMDAMAP 2005: waves on the screw, step by step
=====================  =============================================================================================
"""

from monitor_core.models.protocol import (
    DriveConditions as DriveConditions,
    DriveModel as DriveModel,
    ExcitationPoint as ExcitationPoint,
    MotorEnd as MotorEnd,
    NaturalFrequency as NaturalFrequency,
    NormalModes as NormalModes,
    ResponsePoint as ResponsePoint,
)
