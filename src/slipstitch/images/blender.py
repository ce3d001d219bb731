"""The cloth on its substrate in Blender: scene, lights, camera, and Cycles on the CPU.

The only module that imports bpy. Everything but the cloth is grey, the cloth is a Lambertian
reflector and the floor one that may mirror besides, which is what lets
`slipstitch.images.composition` put textures on afterwards.
"""

import contextlib
import os
import struct
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipstitch.base.errors import SlipstitchError, first_line
from slipstitch.images.camera import Camera
from slipstitch.images.surroundings import FLOOR_M, MATTE, Surroundings

#: Albedo of the cloth in the shading render, per colour channel; see `composition.separate`.
SHADING_ALBEDO = (0.8, 0.0, 0.4)

_LIGHT_GROUPS = ("lamp", "dome")
_BACKGROUND_RADIANCE = 0.006
_DIFFUSE_BOUNCES = 2
# One lamp: with two, each path would pick one at random, and that choice would be most of the
# noise. The fill light is a dome, brightest towards _FILL_FROM, which the camera does not see.
_LAMP_AIM_M = (0.15, 0.0, 0.05)
_LAMP_SIDE_M = 0.15
_LAMP_POWER_W = 15.5
_FILL_RADIANCE = 0.28
_FILL_GRADIENT = 0.6
_FILL_FROM = (-0.30, -0.80, 0.52)


class Rendering(NamedTuple):
    """The output of Blender."""

    # (2, rows, columns, 3) float32: linear light from the lamp, and from dome and background
    radiance: np.ndarray
    # (rows, columns, 3) float32: means over the pixel of u, v (0 off the cloth) and coverage
    uv: np.ndarray
    # (rows, columns, 3) float32: the part of the image reflected by the floor, if reflective
    glossy: np.ndarray | None


@contextlib.contextmanager
def _silent_stdout() -> Iterator[None]:
    """Keep what Blender prints on file descriptor 1 from standard output, which is for results."""
    sys.stdout.flush()
    keep = os.dup(1)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        yield
    finally:
        sys.stdout.flush()
        os.dup2(keep, 1)
        os.close(keep)
        os.close(null)


class ClothScene:
    """One cloth in Blender, triangles (F, 3) with texture coordinates (V, 2), rendered by frames.

    Blender holds one scene a process: a second `ClothScene` replaces the first.
    """

    def __init__(self, faces: np.ndarray, uv: np.ndarray, surroundings: Surroundings = MATTE):
        with _silent_stdout():
            try:
                import bpy
            except ImportError as error:  # a system library, as a rule
                raise SlipstitchError(
                    f"Blender cannot be loaded: {first_line(error)}; slipstitch doctor says how "
                    "to install what is missing"
                ) from None
            bpy.ops.wm.read_factory_settings(use_empty=True)
        self._bpy = bpy
        self._scene = bpy.context.scene
        self._surroundings = surroundings
        self._configure()
        self._make_floor()
        self._make_lamp()
        self._make_cloth(np.asarray(faces), np.asarray(uv, dtype=np.float64))
        data = bpy.data.cameras.new("camera")
        self._camera = bpy.data.objects.new("camera", data)
        self._link(self._camera)
        self._scene.camera = self._camera

    def _link(self, thing) -> None:
        self._scene.collection.objects.link(thing)

    def _configure(self) -> None:
        scene = self._scene
        scene.render.engine = "CYCLES"
        scene.render.threads_mode = "FIXED"
        scene.render.threads = 1  # the rules run several processes
        # Keeping data between frames saves 2 ms of each; a mesh shown as it was before costs more.
        scene.render.use_persistent_data = False
        scene.render.use_compositing = False
        scene.render.use_sequencer = False
        scene.render.dither_intensity = 0.0
        scene.render.resolution_percentage = 100
        scene.render.film_transparent = False
        image = scene.render.image_settings
        image.file_format = "OPEN_EXR_MULTILAYER"
        image.color_depth = "32"
        image.exr_codec = "NONE"
        scene.view_layers[0].use_pass_uv = True
        if self._surroundings.reflects:
            for kind in ("direct", "indirect", "color"):
                setattr(scene.view_layers[0], f"use_pass_glossy_{kind}", True)
        for group in _LIGHT_GROUPS:
            scene.view_layers[0].lightgroups.add(name=group)
        scene.view_settings.view_transform = "Standard"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = False
        cycles.use_auto_tile = False
        # A square filter of one pixel: averaging 2 x 2 pixels then equals rendering at half the
        # resolution, so that composed and direct images show the same thing.
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 1.0
        cycles.max_bounces = _DIFFUSE_BOUNCES
        cycles.diffuse_bounces = _DIFFUSE_BOUNCES
        # No Russian roulette: it would depend on the albedo, and so choose other paths for others.
        cycles.min_light_bounces = _DIFFUSE_BOUNCES + 1
        cycles.use_light_tree = False
        cycles.caustics_reflective = False
        cycles.caustics_refractive = False
        # Clamping cuts each channel at its own value, after which they no longer separate.
        cycles.sample_clamp_direct = 0.0
        cycles.sample_clamp_indirect = 0.0
        cycles.light_sampling_threshold = 0.0
        bpy = self._bpy
        world = bpy.data.worlds.new("background")
        scene.world = world
        world.use_nodes = True
        world.lightgroup = "dome"
        self._light_dome(world.node_tree)
        # Reached by scattered rays only: aiming at it would add a choice between lights.
        world.cycles.sampling_method = "NONE"

    @staticmethod
    def _calculate(tree, kind: str, operation: str, *values):
        """Add a node that calculates with numbers and other nodes' outputs; its output."""
        node = tree.nodes.new(f"ShaderNode{kind}")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            if isinstance(value, float | tuple):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return node.outputs["Value"]

    def _light_dome(self, tree) -> None:
        nodes, link = tree.nodes, tree.links.new
        direction = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
        towards = self._calculate(tree, "VectorMath", "DOT_PRODUCT", direction, _FILL_FROM)
        gradient = _FILL_RADIANCE * _FILL_GRADIENT
        fill = self._calculate(tree, "Math", "MULTIPLY_ADD", towards, gradient, _FILL_RADIANCE)
        seen = nodes.new("ShaderNodeMix")
        seen.data_type = "FLOAT"
        link(nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], seen.inputs["Factor"])
        link(fill, seen.inputs[2])
        seen.inputs[3].default_value = _BACKGROUND_RADIANCE
        background = nodes["Background"]
        background.inputs["Color"].default_value = (1, 1, 1, 1)
        link(seen.outputs[0], background.inputs["Strength"])

    def _diffuse(self, name: str):
        """A material with one Lambertian surface, and that surface's colour socket."""
        material = self._bpy.data.materials.new(name)
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        surface = nodes.new("ShaderNodeBsdfDiffuse")
        output = nodes.new("ShaderNodeOutputMaterial")
        material.node_tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
        return material, surface.inputs["Color"]

    def _make_floor(self) -> None:
        mesh = self._bpy.data.meshes.new("floor")
        mesh.from_pydata(FLOOR_M.tolist(), [], [(0, 1, 2, 3)])
        material, colour = self._diffuse("floor")
        albedo = self._surroundings.albedo
        colour.default_value = (albedo, albedo, albedo, 1)
        if self._surroundings.reflects:
            self._polish(material.node_tree)
        mesh.materials.append(material)
        self._link(self._bpy.data.objects.new("floor", mesh))

    def _polish(self, tree) -> None:
        """Add a specular layer, visible to the camera, to the floor's Lambertian body.

        Light thrown onto the cloth stays Lambertian, with the mirror's share in the albedo: few
        paths resolve mirrored light on rough ground worst.
        """
        nodes, link = tree.nodes, tree.links.new
        normal = self._surroundings.reflectance
        body = next(node for node in nodes if node.type == "BSDF_DIFFUSE")
        output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")

        def calculate(operation: str, first, second):
            return self._calculate(tree, "Math", operation, first, second)

        # Schlick: F = F0 + (1 - F0) (1 - cos)^5.
        sides = nodes.new("ShaderNodeNewGeometry").outputs
        sides = (sides["Incoming"], sides["True Normal"])
        cosine = self._calculate(tree, "VectorMath", "DOT_PRODUCT", *sides)
        grazing = calculate("SUBTRACT", 1.0, calculate("ABSOLUTE", cosine, 0.0))
        grazing = calculate("MULTIPLY", calculate("POWER", grazing, 5.0), 1 - normal)
        fresnel = calculate("ADD", grazing, normal)
        mirror = nodes.new("ShaderNodeBsdfAnisotropic")
        mirror.distribution = "GGX"
        mirror.inputs["Color"].default_value = (1, 1, 1, 1)
        mirror.inputs["Roughness"].default_value = self._surroundings.roughness
        polished = nodes.new("ShaderNodeMixShader")
        link(fresnel, polished.inputs[0])
        link(body.outputs[0], polished.inputs[1])
        link(mirror.outputs[0], polished.inputs[2])
        # Schlick's mean over the hemisphere is F0 + (1 - F0) / 21.
        mean = normal + (1 - normal) / 21
        scattered = nodes.new("ShaderNodeBsdfDiffuse")
        albedo = self._surroundings.albedo * (1 - mean) + mean
        scattered.inputs["Color"].default_value = (albedo, albedo, albedo, 1)
        seen = nodes.new("ShaderNodeMixShader")
        link(nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], seen.inputs[0])
        link(scattered.outputs[0], seen.inputs[1])
        link(polished.outputs[0], seen.inputs[2])
        link(seen.outputs[0], output.inputs["Surface"])

    def _make_lamp(self) -> None:
        from mathutils import Vector

        lamp = self._bpy.data.lights.new("lamp", "AREA")
        lamp.shape = "SQUARE"
        lamp.size = _LAMP_SIDE_M
        lamp.energy = _LAMP_POWER_W
        lamp.cycles.use_multiple_importance_sampling = False
        thing = self._bpy.data.objects.new("lamp", lamp)
        thing.lightgroup = "lamp"
        thing.location = self._surroundings.lamp_position_m
        beam = Vector(_LAMP_AIM_M) - thing.location
        thing.rotation_euler = beam.to_track_quat("-Z", "Y").to_euler()
        self._link(thing)

    def _make_cloth(self, faces: np.ndarray, uv: np.ndarray) -> None:
        mesh = self._bpy.data.meshes.new("cloth")
        mesh.from_pydata(np.zeros((len(uv), 3)).tolist(), [], faces.tolist())
        mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
        corners = np.empty(len(mesh.loops), dtype=np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        layer = mesh.uv_layers.new(name="uv")
        layer.data.foreach_set("uv", uv[corners].astype(np.float32).ravel())
        self._cloth_material, self._cloth_colour = self._diffuse("cloth")
        self._cloth_colour.default_value = (*SHADING_ALBEDO, 1)
        mesh.materials.append(self._cloth_material)
        self._mesh = mesh
        self._link(self._bpy.data.objects.new("cloth", mesh))

    def wear(self, texture: np.ndarray) -> None:
        """Give the cloth a texture (H, W, 3) of linear albedo, row 0 at v = 0."""
        height, width = texture.shape[:2]
        image = self._bpy.data.images.new("texture", width, height, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        rgba = np.ones((height, width, 4), dtype=np.float32)
        rgba[..., :3] = texture
        image.pixels.foreach_set(rgba.ravel())
        image.update()
        tree = self._cloth_material.node_tree
        for node in [node for node in tree.nodes if node.type == "TEX_IMAGE"]:
            tree.nodes.remove(node)
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        node.interpolation = "Linear"
        node.extension = "EXTEND"
        tree.links.new(node.outputs["Color"], self._cloth_colour)

    def render(
        self, positions_m: np.ndarray, camera: Camera, *, samples: int, seed: int = 0
    ) -> Rendering:
        """Render the cloth with these vertices (V, 3) through this camera, at its resolution.

        `samples` are paths per pixel, the first through its centre. SlipstitchError on a full disk.
        """
        self._mesh.vertices.foreach_set("co", np.asarray(positions_m, dtype=np.float32).ravel())
        self._mesh.update()
        self._aim(camera)
        cycles = self._scene.cycles
        cycles.samples = samples
        cycles.seed = seed
        # In memory where it can be: the frames that pass through it are read at once.
        memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        with tempfile.TemporaryDirectory(prefix="slipstitch-", dir=memory) as folder:
            path = Path(folder) / "frame.exr"
            self._scene.render.filepath = str(path)
            with _silent_stdout():
                self._bpy.ops.render.render(write_still=True)
            try:
                channels = read_exr(path)
            except (OSError, struct.error, ValueError, IndexError) as error:
                raise SlipstitchError(
                    f"Blender's image could not be read from {folder} (disk full?): {error}"
                ) from None
        layer = self._scene.view_layers[0].name

        def colours(name: str, letters: str = "RGB") -> np.ndarray:
            return np.stack([channels[f"{layer}.{name}.{c}"] for c in letters], axis=-1)

        glossy = None
        if self._surroundings.reflects:
            glossy = (colours("GlossDir") + colours("GlossInd")) * colours("GlossCol")
        radiance = np.stack([colours(f"Combined_{group}") for group in _LIGHT_GROUPS])
        return Rendering(radiance, colours("UV", "UVA"), glossy)

    def _aim(self, camera: Camera) -> None:
        from mathutils import Matrix

        render = self._scene.render
        columns, rows = camera.size_px
        render.resolution_x, render.resolution_y = columns, rows
        (focal_x, _, middle_x), (_, focal_y, middle_y) = camera.matrix[:2]
        # A pixel's height in units of its width. Blender wants the smaller of its sides to be 1.
        aspect = float(focal_x / focal_y)
        render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1 / aspect), max(1.0, aspect)
        data = self._camera.data
        data.sensor_fit = "HORIZONTAL"
        data.sensor_width = 36.0
        data.lens = float(36.0 * focal_x / columns)
        # Both in units of the image's width; OpenCV's first pixel has its centre at 0.
        data.shift_x = float(((columns - 1) / 2 - middle_x) / columns)
        data.shift_y = float((middle_y - (rows - 1) / 2) * aspect / columns)
        data.clip_start, data.clip_end = 0.01, 100.0
        # Blender's cameras look along -z with y up.
        world = np.eye(4)
        world[:3, :3] = camera.rotation.T @ np.diag([1.0, -1.0, -1.0])
        world[:3, 3] = -camera.rotation.T @ camera.translation_m
        self._camera.matrix_world = Matrix(world.tolist())


def read_exr(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Channels of an uncompressed OpenEXR file of Blender, by name, each float32 (height, width).

    Blender hands float buffers over in no other way without a window: one part, scan lines, 32-bit
    floats ("OpenEXR File Layout", version 2). ValueError for another kind of file.
    """
    with open(path, "rb") as stream:
        data = stream.read()
    magic, version = struct.unpack_from("<II", data, 0)
    if magic != 20000630 or version & 0xFF != 2 or version & 0x1A00:
        raise ValueError(f"{path}: not a single-part scan-line OpenEXR file")
    header, offset = _header(data, 8)
    if header["compression"] != b"\0":
        raise ValueError(f"{path}: compressed")
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names = _channels(header["channels"], path)
    # After the offset table come the lines in order: y, size, then every channel's row.
    offset += 8 * height
    line = 8 + 4 * width * len(names)
    rows = np.frombuffer(data, "<f4", height * line // 4, offset).reshape(height, line // 4)
    pixels = rows[:, 2:].reshape(height, len(names), width)
    return {name: pixels[:, k] for k, name in enumerate(names)}


def _header(data: bytes, offset: int) -> tuple[dict[str, bytes], int]:
    attributes = {}
    while data[offset]:
        end = data.index(0, offset)
        name = data[offset:end].decode()
        offset = data.index(0, end + 1) + 1  # past the name of the type
        (size,) = struct.unpack_from("<I", data, offset)
        attributes[name] = data[offset + 4 : offset + 4 + size]
        offset += 4 + size
    return attributes, offset + 1


def _channels(listing: bytes, path: str | os.PathLike) -> list[str]:
    names, offset = [], 0
    while listing[offset]:
        end = listing.index(0, offset)
        kind, _, x_sampling, y_sampling = struct.unpack_from("<iIii", listing, end + 1)
        if (kind, x_sampling, y_sampling) != (2, 1, 1):
            raise ValueError(f"{path}: channel {listing[offset:end].decode()} is not 32-bit float")
        names.append(listing[offset:end].decode())
        offset = end + 17
    return names
