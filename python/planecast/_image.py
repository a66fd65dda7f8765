"""Pictures, and where they were taken from."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy

if TYPE_CHECKING:
    from ._place import Place


@dataclass(frozen=True)
class Camera:
    """Where a picture was taken from. `eye` in voxels, angles in degrees, `size` (width, height) in pixels."""

    eye: tuple[float, float, float]
    yaw: float
    pitch: float
    roll: float
    fov: float
    size: tuple[int, int]

    @classmethod
    def _of(cls, camera: tuple) -> "Camera":
        eye, yaw, pitch, roll, fov, width, height = camera
        return cls(eye, yaw, pitch, roll, fov, (width, height))

    def words(self) -> dict[str, Any]:
        """The keyword arguments of `World.render` that draw from here."""
        return dict(eye=self.eye, yaw=self.yaw, pitch=self.pitch, roll=self.roll, fov=self.fov, size=self.size)


def png(pixels: numpy.ndarray) -> bytes:
    """A PNG file of (H, W, 3) or (H, W, 4) u1."""
    height, width, channels = pixels.shape
    # Each line begins with how it is filtered: not at all.
    lines = numpy.zeros((height, 1 + width * channels), "u1")
    lines[:, 1:] = pixels.reshape(height, -1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    body = zlib.compress(lines.tobytes(), 4)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@dataclass(frozen=True)
class Image:
    """A drawn picture. Arrays are those that the renderer wrote, without a copy.

    rgba   (H, W, 4) u1, sRGB; sky is transparent with ``sky="none"``, else alpha is 255
    rgb    (H, W, 3) u1, a view of `rgba`
    depth  (H, W) f4, voxels along the camera's forward axis; sky is +inf
    voxel  (H, W, 4) i4: x, y, z of the voxel of level 0 and the level, -1 for sky; None unless asked for
    camera where it was taken from
    stats  what the frame cost, by stage
    """

    rgba: numpy.ndarray
    depth: numpy.ndarray
    voxel: numpy.ndarray | None
    camera: Camera
    stats: dict[str, Any] = field(repr=False)
    _place: "Place | None" = field(default=None, repr=False)

    @property
    def rgb(self) -> numpy.ndarray:
        """(H, W, 3) u1, sRGB; a view."""
        return self.rgba[..., :3]

    def _shown(self) -> numpy.ndarray:
        return self.rgba if (self.rgba[..., 3] != 255).any() else self.rgb

    def save(self, path: str | os.PathLike) -> None:
        """Writes the picture: PNG, or by its ending whatever Pillow writes, where that is installed."""
        name = os.fspath(path)
        if not name.lower().endswith(".png"):
            from PIL import Image as Pillow

            return Pillow.fromarray(numpy.ascontiguousarray(self.rgb)).save(name)
        # Whole or not at all.
        passing = f"{name}.{os.getpid()}.tmp"
        try:
            with open(passing, "wb") as file:
                file.write(png(self._shown()))
            os.replace(passing, name)
        finally:
            if os.path.exists(passing):
                os.remove(passing)

    def _repr_png_(self) -> bytes:
        return png(self._shown())

    def to_xarray(self) -> Any:
        """An xarray.Dataset of `rgb` (row, column, band) and `depth` (row, column); where voxels were asked for also what each
        pixel shows: in the coordinates of the DataArray that was encoded, by their names, or else `voxel` (row, column, 4)."""
        import xarray

        variables: dict[str, Any] = {
            "rgb": (("row", "column", "band"), self.rgb, {"long_name": "picture, sRGB"}),
            "depth": (("row", "column"), self.depth, {"units": "voxels"}),
        }
        if self.voxel is not None and self._place is not None:
            variables |= {name: (("row", "column"), v, a) for name, (v, a) in self._place.of_voxels(self.voxel).items()}
            variables |= self._place.reference()
        elif self.voxel is not None:
            variables["voxel"] = (("row", "column", "axis"), self.voxel)
        return xarray.Dataset(variables, attrs={"eye": list(self.camera.eye), "yaw": self.camera.yaw, "pitch": self.camera.pitch,
                                                "roll": self.camera.roll, "fov": self.camera.fov})
