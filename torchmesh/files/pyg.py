"""Meshes as graphs of PyTorch Geometric, and back.

Source: Fey & Lenssen, Fast graph representation learning with PyTorch Geometric, 2019.
"""

import warnings
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidMeshError, MissingDependencyError
from ..mesh.batch import MeshBatch, join
from ..mesh.quads import edges_of
from ..mesh.typed import typed


@typed
def to_pyg(batch: MeshBatch) -> Any:
    """A `torch_geometric.data.Batch` with one graph for each mesh, on the device of `batch`.

    Each graph (`.to_data_list()`) has

    pos                     (V, 2) the points, of their dtype
    face                    (3, T) int64, as in torch_geometric.transforms.FaceToEdge
    edge_index              (2, 2E) int64, every edge in both directions
    fixed                   (V,) bool
    constrained_edge_index  (2, K) int64, each constrained edge once, as given
    frame                   (1, 3, 3) float64, the mesh's plane in space
    quad_index              (4, Q) int64, in every graph if one of the meshes has quads, and else in none; the
                            diagonals of quads are no edges of the graph

    Raises MissingDependencyError without torch_geometric.
    """
    data, batched = _torch_geometric()
    # torch_geometric takes the names that the first graph has, and counts vertices on where one contains "index".
    quads = len(batch.quads) > 0
    graphs = []
    for mesh in batch.split():
        edge = edges_of(mesh).T
        graphs.append(
            data(
                pos=mesh.points,
                face=mesh.triangles.T.contiguous(),
                edge_index=torch.cat([edge, edge.flip(0)], 1).contiguous(),
                fixed=mesh.fixed,
                constrained_edge_index=mesh.constrained_edges.T.contiguous(),
                frame=mesh.frames,
                **({"quad_index": mesh.quads.T.contiguous()} if quads else {}),
            )
        )
    return batched.from_data_list(graphs)


def from_pyg(graphs: Any) -> MeshBatch:
    """The meshes of a `torch_geometric` Data or Batch with `pos` (V, 2 or 3) and `face` (3, T).

    `fixed`, `constrained_edge_index`, `frame` and `quad_index` are used if they are there.  A graph that has `fixed`
    and `frame`, as those of `to_pyg` do, comes back bit for bit, whatever was done to `pos`, even with inverted
    triangles.  Any other graph goes through `MeshBatch.from_arrays`, which checks and orients it.

    Raises InvalidMeshError, naming the graph, for anything that is no mesh.
    """
    data, batched = _torch_geometric()
    if not isinstance(graphs, data):
        raise InvalidMeshError(f"from_pyg takes a torch_geometric Data or Batch, not {type(graphs).__name__}")
    several = graphs.to_data_list() if isinstance(graphs, batched) else [graphs]
    if not several:
        raise InvalidMeshError("the batch has no graphs")
    return join([_mesh_of(graph, number) for number, graph in enumerate(several)])


def _mesh_of(graph: Any, number: int) -> MeshBatch:
    for name in ("pos", "face"):
        if getattr(graph, name, None) is None:
            raise InvalidMeshError(f"graph {number} has no {name!r}: a mesh needs 'pos' (V, 2) and 'face' (3, T)")
    pos, face = graph.pos, graph.face
    quads = getattr(graph, "quad_index", None)
    if face.ndim != 2 or face.shape[0] != 3:
        raise InvalidMeshError(f"graph {number}: face must have shape (3, T), not {tuple(face.shape)}")
    constrained = getattr(graph, "constrained_edge_index", None)
    edge = torch.zeros((0, 2), dtype=torch.int64, device=pos.device) if constrained is None else constrained.T
    fixed = getattr(graph, "fixed", None)
    frame = getattr(graph, "frame", None)
    if frame is None or fixed is None or pos.shape[1:] != (2,):
        try:
            rows = None if quads is None else quads.T
            return MeshBatch.from_arrays(pos, face.T, fixed=fixed, constrained_edges=edge, quads=rows)
        except InvalidMeshError as error:
            raise InvalidMeshError(f"graph {number}: {error}") from None
    # The graph is one of `to_pyg`.  What from_arrays would check and repair is right, and positions may be anything.
    triangles, count = face.T.contiguous(), len(pos)
    quads = triangles.new_zeros((0, 4)) if quads is None else quads.T.contiguous()
    for name, rows in (("face", triangles), ("constrained_edge_index", edge), ("quad_index", quads)):
        if bool(((rows < 0) | (rows >= count)).any()):
            raise InvalidMeshError(f"graph {number}: {name} names vertices that are not there; there are {count}")

    def ends(size: int) -> Tensor:
        return torch.tensor([0, size], device=pos.device)

    sizes = ends(count), ends(len(triangles))
    return MeshBatch(
        pos, triangles, fixed, edge.contiguous(), *sizes, frame, quads=quads, quad_offsets=ends(len(quads))
    )


def _torch_geometric() -> tuple[Any, Any]:
    try:
        with warnings.catch_warnings():
            # Modules of torch_geometric call torch.jit.script, which is deprecated.
            warnings.simplefilter("ignore", DeprecationWarning)
            from torch_geometric.data import Batch, Data
    except ImportError as error:
        raise MissingDependencyError(
            "to_pyg and from_pyg need torch_geometric: pip install 'torchmesh-untangle[pyg]'"
        ) from error
    return Data, Batch
