"""Arrays in VTK's XML files that are not text: a header, and numbers; in base64 or raw, compressed in blocks or not.

    plain        bytes | numbers
    compressed   blocks, size of a block, size of the last one if it is smaller, compressed sizes | block | block ...

In base64, a plain array is one string; of a compressed one the header is a string of its own.
"""

import base64
import lzma
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..swelling import inflated

# Bytes of a block before it is compressed, as VTK has them.
_BLOCK = 1 << 15

_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor", "vtkLZ4DataCompressor")


@dataclass(frozen=True)
class Coding:
    """How a file stores numbers.

    order       the byte order, as numpy has it
    header      the type of the numbers of a header
    compressor  as VTK calls it; "" for none
    """

    order: Literal["<", ">"] = "<"
    header: str = "u4"
    compressor: str = ""

    @classmethod
    def of(cls, tag: Mapping[str, str]) -> "Coding":
        """From the attributes of a file's first element.  Raises ValueError for an unknown compressor or type."""
        header = {"UInt32": "u4", "UInt64": "u8"}.get(tag.get("header_type", "UInt32"))
        if header is None:
            raise ValueError(f"its header_type {tag['header_type']!r} is not known")
        compressor = tag.get("compressor", "")
        if compressor not in _COMPRESSORS:
            raise ValueError(f"the compressor {compressor!r} is not known")
        return cls(">" if tag.get("byte_order") == "BigEndian" else "<", header, compressor)

    @property
    def number(self) -> np.dtype:
        return np.dtype(self.order + self.header)


def _characters(count: int) -> int:
    """The characters of base64 that stand for so many bytes."""
    return -(-count // 3) * 4


def _bytes(stored: bytes, count: int, raw: bool) -> bytes:
    """The first bytes of a string.  Raises ValueError if there are fewer."""
    found = stored[:count] if raw else base64.b64decode(stored[: _characters(count)])[:count]
    if len(found) < count:
        raise ValueError("an array of it is cut short")
    return found


def _header(stored: bytes, coding: Coding, raw: bool) -> list[int]:
    """The numbers of the header.  Raises ValueError."""
    size = coding.number.itemsize
    (first,) = np.frombuffer(_bytes(stored, size, raw), coding.number).tolist()
    if not coding.compressor:
        return [first]
    if first > len(stored):
        raise ValueError(f"an array of it has {first} blocks, for which it is too small: damaged")
    return np.frombuffer(_bytes(stored, (3 + first) * size, raw), coding.number).tolist()


def length_of(stored: bytes, coding: Coding, raw: bool) -> int:
    """The bytes that the array takes which `stored` begins with."""
    header, size = _header(stored, coding, raw), coding.number.itemsize
    if not coding.compressor:
        return size + header[0] if raw else _characters(size + header[0])
    head, body = len(header) * size, sum(header[3:])
    return head + body if raw else _characters(head) + _characters(body)


def decoded(stored: bytes, coding: Coding, raw: bool, most: int) -> bytes:
    """The bytes of the numbers.  Raises ValueError if the array is cut short or has more than `most` bytes."""
    if not raw:
        stored = stored if not (b"\n" in stored or b" " in stored) else b"".join(stored.split())
    if not stored:
        return b""
    header, size = _header(stored, coding, raw), coding.number.itemsize
    if not coding.compressor:
        return _bytes(stored, size + header[0], raw)[size:]
    head = len(header) * size
    body = stored[head:] if raw else base64.b64decode(stored[_characters(head) :][: _characters(sum(header[3:]))])
    if sum(header[3:]) > len(body):
        raise ValueError("its compressed data is cut short")
    parts, at = [], 0
    for number, length in enumerate(header[3:]):
        block = body[at : at + length]
        if coding.compressor == "vtkLZ4DataCompressor":
            last = number == header[0] - 1 and header[2]
            part = _from_lz4(block, min(header[2] if last else header[1], most))
        else:
            part = inflated(block, coding.compressor, most)
        most -= len(part)
        at += length
        parts.append(part)
    return b"".join(parts)


def encoded(data: bytes, coding: Coding, raw: bool) -> bytes:
    """The array as it stands in a file."""
    if not coding.compressor:
        whole = np.array([len(data)], coding.number).tobytes() + data
        return whole if raw else base64.b64encode(whole)
    parts = [data[start : start + _BLOCK] for start in range(0, len(data), _BLOCK)]
    last = len(data) % _BLOCK
    packed = [_packed(part, coding.compressor) for part in parts]
    header = np.array([len(parts), _BLOCK, last, *map(len, packed)], coding.number).tobytes()
    body = b"".join(packed)
    return header + body if raw else base64.b64encode(header) + base64.b64encode(body)


def _packed(part: bytes, compressor: str) -> bytes:
    if compressor == "vtkZLibDataCompressor":
        return zlib.compress(part)
    if compressor == "vtkLZMADataCompressor":
        return lzma.compress(part)
    return _as_lz4(part)


def _from_lz4(block: bytes, most: int) -> bytes:
    """A block of LZ4, unpacked: literals, and copies of what came before.  Raises ValueError.

    https://github.com/lz4/lz4/blob/dev/doc/lz4_Block_format.md
    """
    out, at, end = bytearray(), 0, len(block)

    def length(first: int, at: int) -> tuple[int, int]:
        while first >= 15:
            first, at, more = first + block[at], at + 1, block[at]
            if more < 255:
                break
        return first, at

    try:
        while at < end:
            token = block[at]
            count, at = length(token >> 4, at + 1)
            if at + count > end or len(out) + count > most:
                raise ValueError("its compressed data is damaged")
            out += block[at : at + count]
            at += count
            if at >= end:
                break
            (back,) = struct.unpack_from("<H", block, at)
            count, at = length(token & 15, at + 2)
            count += 4
            if not 0 < back <= len(out) or len(out) + count > most:
                raise ValueError("its compressed data is damaged")
            run = bytes(out[-back:]) if back < count else bytes(out[len(out) - back : len(out) - back + count])
            out += (run * (count // len(run) + 1))[:count]
    except (IndexError, struct.error):
        raise ValueError("its compressed data is cut short") from None
    return bytes(out)


def _as_lz4(part: bytes) -> bytes:
    """A block of LZ4 that has literals only: any reader unpacks it, and no library is needed to make it."""
    count = len(part)
    if count < 15:
        return bytes([count << 4]) + part
    more, rest = divmod(count - 15, 255)
    return bytes([15 << 4]) + b"\xff" * more + bytes([rest]) + part
