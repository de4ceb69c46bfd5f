"""The commands of `refine-grasp`: one module each, whose class of the same name holds the options."""
