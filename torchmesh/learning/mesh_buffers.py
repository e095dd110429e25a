"""A mesh kept by a module: its tensors are buffers, which move, are saved and are loaded with the module."""

import dataclasses
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch

# Buffers have the names of the fields of a mesh after this.
_PREFIX = "mesh_"

# These stay in double precision whatever the module is converted to: only points have the module's precision.
_DOUBLE = ("frames",)


# The fields of a `MeshBatch` that hold what it is, not what is known of it.
MESH_FIELDS = tuple(f.name for f in dataclasses.fields(MeshBatch) if not f.name.startswith("_"))


class WithMesh(nn.Module):
    """A module with a mesh, or without one.

    mesh  the `MeshBatch`, or None; it may be replaced at any time
    """

    def __init__(self, mesh: MeshBatch | None) -> None:
        super().__init__()
        self._known: MeshBatch | None = None
        self.mesh = mesh

    @property
    def mesh(self) -> MeshBatch | None:
        """The mesh, of the tensors that the module has now."""
        tensors = {name: self._buffers.get(_PREFIX + name) for name in MESH_FIELDS}
        if tensors["points"] is None:
            return None
        known = self._known
        # A mesh that is made anew does not know its half-edge twins.
        if known is None or any(getattr(known, name) is not tensor for name, tensor in tensors.items()):
            self._known = known = MeshBatch(**tensors)  # type: ignore[arg-type]
        return known

    @mesh.setter
    def mesh(self, mesh: MeshBatch | None) -> None:
        if mesh is not None and not isinstance(mesh, MeshBatch):
            raise InvalidMeshError(f"the mesh of a layer must be a MeshBatch or None, not {type(mesh).__name__}")
        self._known = mesh
        for name in MESH_FIELDS:
            self.register_buffer(_PREFIX + name, None if mesh is None else getattr(mesh, name))

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "WithMesh":
        exact = {
            name: self._buffers[_PREFIX + name] for name in _DOUBLE if self._buffers.get(_PREFIX + name) is not None
        }
        super()._apply(fn, recurse)
        for name, before in exact.items():
            now = self._buffers[_PREFIX + name]
            assert before is not None
            assert now is not None
            if now.dtype != before.dtype:
                self._buffers[_PREFIX + name] = before.to(now.device)
        return self

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        """Take the mesh of the state, which may have other numbers of vertices and triangles."""
        for name in MESH_FIELDS:
            saved = state_dict.get(prefix + _PREFIX + name)
            if saved is None:
                continue
            here = self._buffers.get(_PREFIX + name)
            if here is None or here.shape != saved.shape or here.dtype != saved.dtype:
                device = saved.device if here is None else here.device
                self.register_buffer(_PREFIX + name, torch.empty_like(saved, device=device))
            else:
                # The tensor may be the caller's own, which is not written into.
                self.register_buffer(_PREFIX + name, here.clone())
        self._known = None
        super()._load_from_state_dict(state_dict, prefix, *args)
