"""Settings of the render stage. Pydantic and the standard library only."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from slipstitch.config import catalogue
from slipstitch.config.catalogue import FLOORS, VIEWPOINTS, is_texture_file
from slipstitch.config.section import Section, apart, known, once

_of_texture = known(
    "texture", lambda: (*catalogue.TEXTURES, *catalogue.TEXTURE_FAMILY), is_texture_file
)
Textures = Annotated[list[str], _of_texture, once("duplicate texture")]
Floors = Annotated[list[str], known("floor", lambda: FLOORS), once("duplicate floor")]
Viewpoints = Annotated[
    list[str], known("viewpoint", lambda: VIEWPOINTS), once("duplicate viewpoint")
]


class AugmentationSettings(Section):
    """Irrelevant variation between images, all off (0) by default."""

    lamp_m: float = Field(0.0, ge=0.0, le=0.4)
    """maximum displacement of the lamp in each simulation, along each axis"""
    exposure_stops: float = Field(0.0, ge=0.0, le=3.0)
    """maximum change of the exposure of a video, in stops, in either direction"""
    colour_cast: float = Field(0.0, ge=0.0, le=0.5)
    """maximum relative scaling of red and blue in a video, in either direction"""
    noise: float = Field(0.0, ge=0.0, le=0.2)
    """largest standard deviation of a video's camera noise at full white (linear light; shot noise,
    and a read noise a tenth of it)"""
    jpeg_quality: int = Field(100, ge=10, le=100)
    """lowest JPEG quality of a video's compression; 100: uncompressed"""


class BenchCameraSettings(Section):
    """Cameras of the viewpoints ``bench_1`` ... (`slipstitch.images.calibrated_view`)."""

    oversampling: float = Field(1.5, ge=1, le=4)
    """camera pixels per pixel of the rectified image, along each axis"""


class InterpolationSettings(Section):
    """Films of cloths between the simulated ones (`slipstitch.design.interpolation`)."""

    share: float = Field(0.0, ge=0, le=1)
    """share of the films of bench_1 ... that show, where their simulation trains, a cloth
    interpolated between simulations that train; 0: none"""


class RenderSettings(Section):
    """Content and quality of the rendered images."""

    pixels: int = Field(64, ge=16, le=1024)
    """side length of the square images"""
    samples: int = Field(1, ge=1, le=4096)
    """paths per pixel of the shading render, which has twice the resolution (4 times this per pixel
    of the final image)"""
    viewpoints: Viewpoints = Field(["calibrated", "frontal", "side"], min_length=1)
    """viewpoints of the training data, by name; ids v00.. in this order"""
    textures: Textures = Field(["stripes", "tartan", "floral"], min_length=1)
    """cloth textures of the training data, by name, or image files; ids t00.. in this order;
    cloth_1 ... cloth_8 are drawn anew for every simulation and viewpoint"""
    test_textures: Textures = []
    """textures for testing only; their ids follow those of `textures`"""
    test_viewpoints: Viewpoints = []
    """viewpoints for testing only; their ids follow those of `viewpoints`"""
    test_viewpoint_videos: int | None = Field(None, ge=1)
    """videos from each test viewpoint, drawn at random among simulations and training textures (the
    paper: 20); null: every simulation in every texture"""
    frames: Literal["sampled", "all"] = "sampled"
    """render only the frames that the sample stage uses, or every frame"""
    floors: Floors = Field(["matte"], min_length=1)
    """floors by name; each fabric and replicate, with `bench_…` cameras each film, draws one, with
    its roughness and reflectance"""
    reflective_floors: Floors = []
    """floors of a second training set: the same simulations once more, from the training viewpoints
    in the training textures, each drawing a floor of these for every viewpoint; their ids follow
    those of `test_viewpoints`"""
    augmentation: AugmentationSettings = Field(default_factory=AugmentationSettings)
    bench_camera: BenchCameraSettings = Field(default_factory=BenchCameraSettings)
    interpolation: InterpolationSettings = Field(default_factory=InterpolationSettings)
    camera: str | None = Field(None, min_length=1)
    """camera file of `slipstitch capture camera`: places the calibrated viewpoint, and those
    rotated from it, where that camera is; null: as in the catalogue"""
    verified_images: int = Field(6, ge=0, le=100000)
    """images of the dataset, drawn at random, that are also rendered directly"""

    @model_validator(mode="after")
    def _train_and_test_are_apart(self) -> "RenderSettings":
        apart(self, "textures", "viewpoints")
        test_only = sorted(set(self.textures) & catalogue.TEST_ONLY_TEXTURES) + sorted(
            name for name in self.viewpoints if VIEWPOINTS[name].test_only
        )
        if test_only:
            raise ValueError(f"{', '.join(test_only)}: for testing only, must not be used to train")
        return self

    def camera_of(self, viewpoint: str) -> str | None:
        """The camera file that a viewpoint's camera stands by, None if it is the catalogue's."""
        of_it = viewpoint.startswith("calibrated") or VIEWPOINTS[viewpoint].drawn
        return self.camera if of_it else None

    def texture_files(self) -> list[str]:
        """Textures that are read from image files."""
        return [name for name in self.textures + self.test_textures if is_texture_file(name)]
