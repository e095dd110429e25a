"""The colours of every picture: plots, films and the report page show a mesh in the same ones.

One scale serves them all: the inverse mean ratio from 1 (equilateral, pale) to 3 and beyond (dark blue), logarithmic.
Inverted triangles are vermilion, which readers with any colour vision tell from blue, and hatched, which tells them
in grey.  What is left of faults at places is marked by numbers in red rings.
"""

# ColorBrewer's YlGnBu of nine classes (C. A. Brewer), from the best shape to the worst.
SHAPES = ("#ffffd9", "#edf8b1", "#c7e9b4", "#7fcdbb", "#41b6c4", "#1d91c0", "#225ea8", "#253494", "#081d58")

# The inverse mean ratio from which on a triangle has the last colour, and the ratios marked beside the colours.
WORST_SHOWN = 3.0
TICKS = (1, 1.25, 1.5, 2, 2.5, 3)

# Inverted triangles: their area, their outline, and text that speaks of them.
INVERTED = "#d55e00"
INVERTED_OUTLINE = "#7f3200"
INVERTED_TEXT = "#a34700"

# The part of the background that still shows the range of inverted triangles in a histogram.
SHADE_OPACITY = 0.12

# Histograms: a grey area, through which one sees, for the mesh before; a blue line for the mesh after.
BEFORE = "#8c8c8c"
BEFORE_OPACITY = 0.55
AFTER = "#0072b2"

# The edges of triangles, those at the boundary, and those of interfaces, which are dashed over a pale line.
EDGE = "#404d59"
BOUNDARY = "#303840"
INTERFACE = "#111111"
INTERFACE_PALE = "#ffffff"

# The page in the dark: its background, that of the picture, the boundary, and what else must stand out from them.
DARK = {"canvas": "#15191d", "boundary": "#c3ccd4", "after": "#56b4e9", "inverted-text": "#ff9a4d", "before": "#a3a3a3"}
LIGHT_CANVAS = "#ffffff"

# The rectangle of a close-up, and the outline of a selected triangle.
FRAME = "#cc0000"


def css() -> str:
    """The colours as CSS variables, for the style of a page."""
    variables = {
        "inverted": INVERTED,
        "inverted-outline": INVERTED_OUTLINE,
        "inverted-text": INVERTED_TEXT,
        "shade-opacity": SHADE_OPACITY,
        "before": BEFORE,
        "before-opacity": BEFORE_OPACITY,
        "after": AFTER,
        "shapes": ",".join(SHAPES),
    }
    light = ":root {" + " ".join(f" --{name}: {value};" for name, value in variables.items()) + " }\n"
    dark = " ".join(f"--{name}: {DARK[name]};" for name in ("after", "inverted-text", "before"))
    return f"{light}@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
