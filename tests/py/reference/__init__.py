"""Independent reference of the navigation filter: dense numpy, textbook form, slow and short.

Written from the equations and not from the engine, so that agreement of the two is evidence. Frames, signs
and units are those of the engine: n is north-east-down, b is forward-right-down, quaternions are scalar
first, navigation errors are estimate minus truth, block states are true parameter minus estimated parameter,
``C_est = (I - [phi x]) C_true``.
"""
