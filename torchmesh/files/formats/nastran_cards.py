"""The entries of a Nastran bulk data deck, in free, small and large fields.

GRID,5,,1.4,0.5,0.0                                      free: fields between commas
GRID           5             1.4      .5      0.         small: ten fields of eight columns
GRID*                  5                             1.4              .5*        large: fields of sixteen columns,
*                     0.                                              goes on in the next line
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

# Fields of a line of an entry, besides the first field and the mark of continuation.
_SMALL, _LARGE = 8, 16


@dataclass(frozen=True)
class Field:
    """A field: its text without blanks, and its span as `deck.SPAN` has it."""

    text: str
    span: tuple[int, int, int, int]


@dataclass
class Entry:
    """An entry of the bulk data.

    name    in capitals, without the mark * of large fields
    fields  those behind the name, in the order of small field entries: fields[0] is field 2
    free    are its fields between commas
    """

    name: str
    fields: list[Field]
    free: bool

    def text(self, index: int) -> str:
        """The text of a field, "" for one that is left out."""
        return self.fields[index].text if index < len(self.fields) else ""


def entries(lines: list[str], begin: int, end: int) -> Iterator[Entry]:
    """The entries between two lines.  Columns are counted with tabs expanded.  Raises ValueError for INCLUDE."""
    current: Entry | None = None
    for number in range(begin, end):
        body = lines[number].rstrip("\r\n").split("$", 1)[0]
        body = body if "," in body else body.expandtabs(8)
        if not body.strip():
            continue
        if re.match(r"\s*INCLUDE\b", body, re.IGNORECASE):
            raise ValueError(f"line {number + 1}: it has INCLUDE; put the text of the included file in its place")
        head = (body.split(",", 1)[0] if "," in body else body[:8]).strip()
        goes_on = current is not None and (not head or head[0] in "+*")
        name = head.rstrip("*").strip().upper()
        fields = _fields(number, body, head)
        if goes_on and current is not None:
            current.fields += fields
            continue
        if current is not None:
            yield current
        current = Entry(name, fields, "," in body)
    if current is not None:
        yield current


def _fields(line: int, body: str, head: str) -> list[Field]:
    """The fields of a line behind the first one, as many as a line of this form has."""
    large = head.endswith("*") or head.startswith("*")
    count = 4 if large else 8
    if "," in body:
        found = []
        for match in list(re.finditer(r"(?:^|(?<=,))[^,]*", body))[1:]:
            text = match[0].strip()
            start = match.start() + len(match[0]) - len(match[0].lstrip()) if text else match.start()
            found.append(Field(text, (line, start, start + len(text), 0)))
        found = found[:count]
        while len(found) < count:  # fields that are left out at the end: their commas come with their text
            missing = 1 + sum(field.span[3] < 0 for field in found)
            end = len(body.rstrip())
            found.append(Field("", (line, end, end, -missing)))
        return found
    width = _LARGE if large else _SMALL
    spans = [(8 + k * width, 8 + (k + 1) * width) for k in range(count)]
    return [Field(body[a:b].strip(), (line, a, min(b, max(len(body), a)), width)) for a, b in spans]


def real(text: str) -> float:
    """A real number as Nastran writes it: 1.5, 1.5E3, 1.5D3, 1.5+3; blank is 0."""
    if not text:
        return 0.0
    text = re.sub(r"[dD]", "e", text)
    return float(re.sub(r"(?<=[\d.])([+-]\d)", r"e\1", text) if "e" not in text.lower() else text)


def real_text(value: float, width: int) -> str:
    """The text of a real number with as many digits as `width` characters hold, always with a point.

    The exponent has no letter where that saves a character, and a zero before the point is left out.
    """
    best = ""
    for digits in range(17, 0, -1):
        forms = (_shortened(f"{value:.{digits}g}"), _shortened(f"{value:.{digits - 1}e}"))
        fitting = [text for text in forms if len(text) <= width]
        if fitting:
            best = min(fitting, key=lambda text: (abs(real(text) - value), len(text)))
            break
    for places in range(width, 0, -1):  # plain decimals may hold a digit more than the forms above
        text = _shortened(f"{value:.{places}f}")
        if len(text) <= width:
            return min((best, text), key=lambda t: (abs(real(t) - value), len(t))) if best else text
    return best


def _shortened(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa.rstrip("0") if "." in mantissa else mantissa + "."
    mantissa = re.sub(r"^(-?)0\.(?=\d)", r"\1.", mantissa)
    if mantissa in (".", "-.", "-0."):
        mantissa = "0."
    return mantissa + (f"{int(exponent):+d}" if exponent else "")
