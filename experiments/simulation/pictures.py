"""Plots of the simulations, and a film of the one in the channel."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.simulation.runs import Run, simulated
from experiments.simulation.ways import WAYS, channel

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# Okabe & Ito's colours can be told apart with any colour vision; lines tell the ways apart in print.
_STYLES = (
    ("-", "#0072B2"), ("-", "#E69F00"), ("--", "#009E73"), (":", "#D55E00"), ("-.", "#CC79A7"), ("-", "#000000"),
    ("-", "#56B4E9"), ("--", "#999999"), (":", "#000000"),
)  # fmt: skip


def draw(runs: dict[str, Run], out: Path) -> None:
    """Drift, least angle and the time of meshing over the steps."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 1, figsize=(8, 9), sharex=True, layout="constrained")
    axes[0].set_title("A disc through a channel and back, by each way to move the mesh")
    for (name, run), (line, colour) in zip(runs.items(), _STYLES, strict=False):
        style = {"linestyle": line, "color": colour, "linewidth": 1.2}
        axes[0].semilogy(np.maximum(run.drift, 1e-17), label=name, **style)
        axes[1].plot(run.angle, **style)
        axes[2].semilogy(1e3 * np.asarray(run.meshing), **style)
    for axis, label in zip(
        axes, ("drift of the heat, relative", "least angle, degrees", "meshing, ms a step"), strict=True
    ):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[2].set_xlabel("step")
    figure.legend(loc="outside right center", fontsize=8)
    figure.savefig(out / "channel.png", dpi=110)
    plt.close(figure)


def draw_forces(runs: dict[str, tuple[list[float], list[float]]], dt: float, out: Path) -> None:
    """Drag and lift of the cylinder over time, for each run."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    axes[0].set_title("Flow past a cylinder that oscillates across the stream, Reynolds number 100")
    for (name, (drag, lift)), (line, colour) in zip(
        runs.items(), (("-", "#000000"), ("--", "#0072B2"), (":", "#D55E00")), strict=False
    ):
        times = dt * np.arange(1, len(drag) + 1)
        axes[0].plot(times, drag, linestyle=line, color=colour, label=name)
        axes[1].plot(times, lift, linestyle=line, color=colour)
    for axis, label in zip(axes, ("drag coefficient", "lift coefficient"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[1].set_xlabel("time, diameters over the speed of the stream")
    axes[0].set_ylim(0, 2 * max(np.median(drag) for drag, _ in runs.values()))
    figure.legend(loc="outside right center")
    figure.savefig(out / "cylinder.png", dpi=110)
    plt.close(figure)


def film(out: Path, size: float, steps: int) -> None:
    """The way of the guide, as a film."""
    import matplotlib.pyplot as plt
    from matplotlib.animation import FuncAnimation, PillowWriter

    frames: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    way, method = WAYS["deform, when, L2"]
    simulated(
        channel(size), way, method, steps,
        lambda run: frames.append((run.mesh.points.numpy(), run.mesh.triangles.numpy(), run.values.numpy())),
    )  # fmt: skip
    figure, axis = plt.subplots(figsize=(9, 3.2), layout="constrained")

    def show(k: int) -> Iterable[Artist]:
        axis.clear()
        axis.set_title(f"heat (0 to 0.5) in a channel, step {k + 1} of {steps}")
        points, triangles, values = frames[k]
        axis.tripcolor(*points.T, triangles, values, shading="gouraud", vmin=0, vmax=0.5)
        axis.triplot(*points.T, triangles, color="white", lw=0.2, alpha=0.5)
        axis.set_aspect("equal")
        axis.set_axis_off()
        return axis.get_children()

    FuncAnimation(figure, show, len(frames)).save(out / "channel.gif", PillowWriter(10))
    plt.close(figure)
