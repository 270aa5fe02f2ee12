"""Messages without a standard type: JSON in std_msgs/String, each with its model, its JSON Schema and a version.

A field that is added keeps the version; another meaning of a field, or one less, raises it. The schemas are in
`config/json_topics.schema.json`, which `python -m ltm_msgs_py.json_topics` prints."""

import json
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError
from pydantic.json_schema import models_json_schema
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.base.strict_model import problem_text
from ltm_core.vision.labels import UNLABELLED, LabelSet


class JsonMessage(BaseModel):
    """Base class. Unknown fields are errors, because a publisher of a later version must be seen."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True)

    def to_msg(self) -> String:
        return String(data=self.model_dump_json())


class Label(JsonMessage):
    """A class of pixels or cells."""

    id: int = Field(ge=0, lt=UNLABELLED)
    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")
    color: list[int] = Field(min_length=3, max_length=3)
    """Red, green and blue, 0 to 255."""
    ground_cover: bool
    """Whether the class votes in fuel cells."""


class LabelInfo(JsonMessage):
    """`labels/info`: classes of the label images, and the network."""

    version: Literal[1] = 1
    unlabelled: int
    """Id of pixels without a label."""
    labels: list[Label] = Field(min_length=1)
    model: str = Field("", max_length=200)
    """Network and label head; empty: unknown."""
    reliability: str = Field("", max_length=200)
    """What the labels were measured on."""


class FuelMapInfo(JsonMessage):
    """`fuel_map/info`: meaning and place of the fuel map's cells."""

    version: Literal[1] = 1
    unlabelled: int
    labels: list[Label]
    """Life forms."""
    crs: str
    x_min: float
    """Western edge of the grid in the CRS."""
    y_max: float
    """Northern edge of the grid in the CRS."""
    origin: tuple[float, float]
    """Origin (x, y) of the map frame in the CRS."""
    growth: dict[str, JsonValue]
    """Limits of growth, as in the site file."""
    labels_measured: str
    """What the labels were measured on."""


class FuelCode(JsonMessage):
    """A fuel model."""

    code: int
    name: str


class CameraOfTile(JsonMessage):
    """What a camera has contributed to the tile of a cell."""

    camera: str
    model: str
    frames: int
    first_ns: int
    last_ns: int


class FuelMapAnswer(JsonMessage):
    """`fuel_map/answer`: what is known of the queried cell."""

    version: Literal[1] = 1
    x: float
    """Queried place in `map`, metres."""
    y: float
    stamp_ns: int
    """Stamp of the query."""
    row: int
    """Row of the cell, from the north."""
    col: int
    prior: FuelCode | None
    fuel: FuelCode | None
    life_form: str
    p_max: float | None
    """Probability of the life form."""
    entropy: float
    evidence: float
    changed: bool
    """Whether the code differs from the prior's."""
    last_seen_ns: int
    seen_by: int
    """Number of cameras."""
    tile: list[CameraOfTile]


class TerrainInfo(JsonMessage):
    """`terrain/info`: meaning and place of the terrain map's cells."""

    version: Literal[1] = 1
    kinds: dict[str, int]
    """Values of the kinds of change."""
    crs: str
    x_min: float
    y_max: float
    resolution: float
    """Size of a cell, metres."""
    width: int
    height: int
    threshold: float
    """Least change, metres."""
    canopy_known: bool
    cameras: list[str]


class Geometry(JsonMessage):
    """A geometry of RFC 7946."""

    type: Literal["Point", "Polygon"]
    coordinates: list[JsonValue]


class Feature(JsonMessage):
    """A place, an ellipse or a mode."""

    type: Literal["Feature"] = "Feature"
    geometry: Geometry
    properties: dict[str, JsonValue]


class LocateTracks(JsonMessage):
    """`locate/tracks`: all tracks of the site, as GeoJSON (RFC 7946) with two further members."""

    version: Literal[1] = 1
    type: Literal["FeatureCollection"] = "FeatureCollection"
    stamp_ns: int
    features: list[Feature]


JSON_TOPICS: dict[str, type[JsonMessage]] = {
    "labels/info": LabelInfo,
    "fuel_map/info": FuelMapInfo,
    "fuel_map/answer": FuelMapAnswer,
    "terrain/info": TerrainInfo,
    "locate/tracks": LocateTracks,
}


def json_schemas() -> dict[str, Any]:
    """Return the content of `config/json_topics.schema.json`: the schema of each topic."""
    models = [(model, "serialization") for model in JSON_TOPICS.values()]
    _, schemas = models_json_schema(models)  # type: ignore[arg-type] # a list is invariant
    topics = {topic: {"$ref": f"#/$defs/{model.__name__}"} for topic, model in JSON_TOPICS.items()}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "properties": topics, **schemas}


def label_set_to_msg(labels: LabelSet, model: str = "", reliability: str = "") -> String:
    """Return classes and colours; `model`: the network; `reliability`: what its labels were measured on."""
    return LabelInfo(**labels.info(), model=model, reliability=reliability).to_msg()


def msg_to_model(msg: Any) -> str:
    """Return the network of a `labels/info` message; empty if not stated. Raises MessageError for another message."""
    try:
        return LabelInfo.model_validate_json(msg.data).model
    except ValidationError as error:
        raise MessageError(f"labels/info is not a label set: {problem_text(error)}; got {msg.data[:120]!r}") from error


if __name__ == "__main__":
    print(json.dumps(json_schemas(), indent=1))
