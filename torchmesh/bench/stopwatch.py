"""Wall time and processor time of some work."""

import os
import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Seconds:
    """The wall time and the processor time of some work."""

    wall: float
    cpu: float

    def __add__(self, other: "Seconds") -> "Seconds":
        return Seconds(self.wall + other.wall, self.cpu + other.cpu)

    def __sub__(self, other: "Seconds") -> "Seconds":
        return Seconds(self.wall - other.wall, self.cpu - other.cpu)

    def __mul__(self, factor: float) -> "Seconds":
        return Seconds(self.wall * factor, self.cpu * factor)

    def least(self, other: "Seconds") -> "Seconds":
        """The smaller wall time and the smaller processor time of the two."""
        return Seconds(min(self.wall, other.wall), min(self.cpu, other.cpu))

    def over(self, other: "Seconds") -> "Seconds":
        """The ratios of this to `other`."""
        return Seconds(self.wall / other.wall, self.cpu / other.cpu)

    def __str__(self) -> str:
        return f"{self.wall:.4g} s (cpu {self.cpu:.4g})"


class Stopwatch:
    """`with Stopwatch() as watch: ...` leaves `watch.seconds`."""

    def __enter__(self) -> "Stopwatch":
        self._wall, self._cpu = time.perf_counter(), self._processor_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = Seconds(time.perf_counter() - self._wall, self._processor_time() - self._cpu)

    @staticmethod
    def _processor_time() -> float:
        """The processor time of this process and of its children that have ended."""
        times = os.times()
        return time.process_time() + times.children_user + times.children_system
