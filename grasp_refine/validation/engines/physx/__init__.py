"""PhysX as a third engine of the simulation: the one behind Isaac Gym and Isaac Lab, on the CPU, by SAPIEN's package.

Import it only where it is wanted: it needs the extra `physx`.
"""
