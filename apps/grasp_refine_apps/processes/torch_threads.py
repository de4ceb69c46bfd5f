"""Number of threads of torch, where it is loaded at all."""

from grasp_refine.refinement.config import Config


def limit_torch_threads(config: Config) -> None:
    """Limit torch to one thread if the solver needs it, since the tensors of a batch of grasps are small."""
    if not config.solver.needs_autograd:
        return
    # It takes a second to load.
    import torch

    torch.set_num_threads(1)
