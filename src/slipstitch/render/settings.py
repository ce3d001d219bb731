"""Settings of the render stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from slipstitch.render.catalogue import TEST_ONLY_TEXTURES, TEXTURES, VIEWPOINTS


class RenderSettings(BaseModel):
    """What is rendered of each simulation, and how."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    pixels: int = Field(64, ge=16, le=1024, description="side of the square images")
    samples: int = Field(
        1,
        ge=1,
        le=4096,
        description="paths per pixel of the shading render, which has twice the resolution "
        "(4 times this per pixel of the final image)",
    )
    viewpoints: list[str] = Field(
        ["calibrated", "frontal", "side"],
        min_length=1,
        description="viewpoints of the training data, by name; ids v00.. in this order",
    )
    textures: list[str] = Field(
        ["stripes", "tartan", "floral"],
        min_length=1,
        description="cloth textures of the training data, by name; ids t00.. in this order",
    )
    test_textures: list[str] = Field(
        [], description="textures kept for testing; their ids follow those of `textures`"
    )
    test_viewpoints: list[str] = Field(
        [], description="viewpoints kept for testing; their ids follow those of `viewpoints`"
    )
    frames: Literal["sampled", "all"] = Field(
        "sampled",
        description="render only the frames that the sample stage uses, or every frame",
    )
    crop: Literal["follow", "fixed"] = Field(
        "follow",
        description="the image is a crop of a fixed camera's: it follows the known stage path, "
        "or covers the whole path",
    )
    camera: str | None = Field(
        None,
        min_length=1,
        description="camera file of `slipstitch capture camera`: the calibrated viewpoint, and "
        "those turned from it, stand where that camera stands; null: the catalogue's own",
    )
    threads: int = Field(1, ge=1, le=256, description="threads of Blender")

    @field_validator("textures", "test_textures")
    @classmethod
    def _textures_exist(cls, names: list[str]) -> list[str]:
        return _known(names, TEXTURES, "texture")

    @field_validator("viewpoints", "test_viewpoints")
    @classmethod
    def _viewpoints_exist(cls, names: list[str]) -> list[str]:
        return _known(names, VIEWPOINTS, "viewpoint")

    @model_validator(mode="after")
    def _train_and_test_are_apart(self) -> "RenderSettings":
        for kind in ("textures", "viewpoints"):
            train, test = getattr(self, kind), getattr(self, f"test_{kind}")
            both = sorted(set(train) & set(test))
            if both:
                raise ValueError(f"{kind} and test_{kind} share {', '.join(both)}")
        test_only = sorted(set(self.textures) & TEST_ONLY_TEXTURES) + sorted(
            name for name in self.viewpoints if VIEWPOINTS[name].test_only
        )
        if test_only:
            raise ValueError(f"{', '.join(test_only)}: for testing only, not for training")
        return self

    def texture_ids(self) -> dict[str, str]:
        """Ids t00, t01, ... -> names, training textures first."""
        return {f"t{i:02d}": name for i, name in enumerate(self.textures + self.test_textures)}

    def camera_of(self, viewpoint: str) -> str | None:
        """The camera file that a viewpoint's camera stands by, None if it is the catalogue's."""
        return self.camera if viewpoint.startswith("calibrated") else None

    def viewpoint_ids(self) -> dict[str, str]:
        """Ids v00, v01, ... -> names, training viewpoints first."""
        names = self.viewpoints + self.test_viewpoints
        return {f"v{i:02d}": name for i, name in enumerate(names)}


def _known(names: list[str], catalogue: dict, kind: str) -> list[str]:
    for name in names:
        if name not in catalogue:
            raise ValueError(f"no {kind} {name!r}; there are: {', '.join(catalogue)}")
    if len(set(names)) != len(names):
        raise ValueError(f"a {kind} is named twice: {', '.join(names)}")
    return names
