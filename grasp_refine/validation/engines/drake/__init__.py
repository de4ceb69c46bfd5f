"""Drake as a second engine of the simulation, with another contact model and another solver than MuJoCo's.

Import it only where it is wanted: it needs the extra `drake`.
"""
