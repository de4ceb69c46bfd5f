"""Programs built on the library, one package each: viewer, batch, bench; installed as `grasp_refine.apps`."""
