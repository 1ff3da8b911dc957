"""Checks of the GPU that a line's regressors weigh on."""

from __future__ import annotations

from importlib.util import find_spec

from conveyor.config import LineConfig
from conveyor.errors import InputError
from tuberline.doctor.finding import Finding, fault, ok, warning

WITHOUT = 'set regressor.device = "cpu" where there is none'


def check_gpu(config: LineConfig) -> list[Finding]:
    """The GPU can be used and its sampling kernel be built; nothing where no regressor of this machine asks for one."""
    if config.regressor.device == "cpu" or config.regressor.processes == 0:
        return []
    if find_spec("torch") is None:
        return [fault("GPU", "torch is not installed here", f"install it with CUDA; {WITHOUT}")]
    import torch

    from regressor.network.batched import KERNEL_NEEDS, kernel_fault
    from regressor.network.device import usable_device

    try:
        device = usable_device(config.regressor.device)
    except InputError as error:
        return [fault("GPU", str(error), WITHOUT)]
    name = torch.cuda.get_device_name(device)
    if broken := kernel_fault(device):
        return [warning("GPU", f"{name}: {broken}", KERNEL_NEEDS)]
    return [ok("GPU", f"{name}, and its sampling kernel can be built")]
