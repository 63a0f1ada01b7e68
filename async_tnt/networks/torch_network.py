"""Torch modules as classifiers: volume -> logits."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch


class TorchClassifier:
    """A torch module as a classifier: volume (C, H, W) -> logits (n_classes,).

    `Processor(config, classifier=TorchClassifier(module))` decides by any callable from a tensor (1, C, H, W) to
    logits: a module, TorchScript, a `torch.export.ExportedProgram`, a plain function of tensors. It is put into eval
    mode and called in inference mode, on the device and in the floating type of its first parameter.

    Parameters
    ----------
    module : as above. Its logits are a tensor of any shape that has one axis longer than 1, as (1, n_classes).
        Modules are put into eval mode where they stand: call `module.train()` before training goes on.
    threads : given to `torch.set_num_threads`, once, here. That is process wide: it holds for all of torch in this
        process, also for other classifiers and for a training beside them. None leaves it as it is.

    Raises
    ------
    ImportError : torch is not installed.
    TypeError : `module` cannot be called; (when called) it returns something else than a tensor.
    ValueError : `threads` is less than 1; (when called) the logits have another shape.
    """

    def __init__(self, module: Callable[[torch.Tensor], torch.Tensor], *, threads: int | None = 1) -> None:
        try:
            import torch
        except ImportError as error:
            raise ImportError(f"torch modules need torch: pip install '.[reference]' ({error})") from None
        if isinstance(module, torch.export.ExportedProgram):
            module = module.module()
        if not callable(module):
            raise TypeError(f"`module` must be callable, got {type(module).__name__}")
        if threads is not None:
            if not isinstance(threads, int) or isinstance(threads, bool):
                raise TypeError(f"`threads` must be a whole number or None, got {threads!r}")
            if threads < 1:
                raise ValueError(f"`threads` must be at least 1, got {threads}")
            torch.set_num_threads(threads)
        self.module = module
        self._torch = torch
        self._like = torch.empty(0)  # on the device and of the type that the module wants
        if isinstance(module, torch.nn.Module):
            with suppress(NotImplementedError):  # of an exported program, which keeps the mode it was exported in
                module.eval()
            weights = (w for w in chain(module.parameters(), module.buffers()) if w.is_floating_point())
            first = next(weights, self._like)
            self._like = torch.empty(0, dtype=first.dtype, device=first.device)

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """Logits of one volume: float32, shape (n_classes,), a new array."""
        torch = self._torch
        # One copy, 1 us for 9 x 34 x 34: torch has no read-only tensors, and a module that works in place (a first
        # layer `ReLU(inplace=True)`) or keeps its input would otherwise write into, or read from, the open window.
        tensor = torch.from_numpy(np.array(volume, np.float32))[None].to(self._like)
        with torch.inference_mode():
            logits: Any = self.module(tensor)
            if not isinstance(logits, torch.Tensor):
                raise TypeError(f"the module must return a tensor of logits, got {type(logits).__name__}")
            if logits.numel() == 0 or logits.numel() != max(logits.shape, default=1):
                raise ValueError(f"the module must return logits (1, n_classes), got shape {tuple(logits.shape)}")
            answer: np.ndarray = logits.reshape(-1).to("cpu", torch.float32).numpy()
        return answer.copy()  # the module may keep its tensor
