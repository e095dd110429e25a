"""CGNS files in ADF, the form before HDF5, written node by node for tests."""

import itertools
import struct

import numpy as np

KINDS = {"i4": "I4", "i8": "I8", "f4": "R4", "f8": "R8", "i1": "C1"}


def from_hdf5(group, version="A", pieces=1):
    """The bytes of an ADF file with the tree of an open CGNS file in HDF5; `pieces` parts for each array."""
    out = bytearray(b"\xc0\xa8\xa3\xa9ADF Database Version " + (b"A02011" if version == "A" else b"B02012") + b">")
    out += b"AdF0".ljust(32) + b"AdF1".ljust(32) + b"AdF2LB" + b"AdF3"
    out = out.ljust(266, b" ")

    def place(at):
        block, offset = divmod(at, 4096)
        return f"{block:08X}{offset:04X}".encode() if version == "A" else struct.pack("<QI", block, offset)

    def size(n):
        return f"{n:08X}".encode() if version == "A" else struct.pack("<Q", n)

    def put(node):
        at = len(out)
        out.extend(bytes(246))
        data = node[" data"][()] if " data" in node else None
        where, shape, kind, parts = place(0), [], "MT", 0
        if data is not None:
            raw, kind, parts = data.tobytes(), KINDS[data.dtype.str[1:]], pieces
            shape = list(reversed(data.shape))
            cuts = np.linspace(0, len(raw), pieces + 1).astype(int)
            spans = []
            for low, high in itertools.pairwise(cuts.tolist()):
                begin = len(out)
                end = begin + 16 + high - low
                out.extend(b"DaTa" + place(end) + raw[low:high] + b"dEnD")
                spans.append((begin, end))
            where = place(spans[0][0])
            if pieces > 1:
                where = place(len(out))
                rows = b"".join(place(a) + place(b) for a, b in spans)
                out.extend(b"DCtb" + place(len(out) + 16 + len(rows)) + rows + b"dcTE")
        names = [name for name in node if not name.startswith(" ")]
        table = place(0)
        if names:
            start = len(out)
            table = place(start)
            out.extend(b"SNTb" + place(start + 16 + 44 * len(names)) + bytes(44 * len(names)) + b"snTE")
            for k, name in enumerate(names):
                entry = start + 16 + 44 * k
                out[entry : entry + 44] = name.encode().ljust(32) + place(len(out))
                put(node[name])
        label = node.attrs["label"].decode() if "label" in node.attrs else ""
        sizes = b"".join(size(n) for n in (shape + [0] * 12)[:12])
        head = b"NoDe" + node.name.rsplit("/", 1)[-1].encode().ljust(32) + label.encode().ljust(32)
        head += f"{len(names):08X}{len(names):08X}".encode() + table + kind.encode().ljust(32)
        head += f"{len(shape):02X}".encode() + sizes + f"{parts:04X}".encode() + where + b"TaiL"
        out[at : at + 246] = head

    put(group)
    return bytes(out)
