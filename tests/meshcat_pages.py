"""Contents of MeshCat and its pages, decoded by an independent reader of MessagePack."""

import base64
import re

import msgpack
import numpy as np


def commands(page):
    """Return the commands, as dictionaries, that a page gives MeshCat when it is opened."""
    found = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', page)
    return [msgpack.unpackb(base64.b64decode(text), strict_map_key=False) for text in found]


def tracks(page):
    """Return (path, property) -> (frames, values) of the page's animation."""
    (animation,) = [c for c in commands(page) if c["type"] == "set_animation"]
    return {
        (one["path"], track["name"].removeprefix(".")): (
            [key["time"] for key in track["keys"]],
            [key["value"] for key in track["keys"]],
        )
        for one in animation["animations"]
        for track in one["clip"]["tracks"]
    }


def drawn(page):
    """Return the paths of the objects of a page."""
    return {c["path"] for c in commands(page) if c["type"] == "set_object"}


def transform(meshcat, path):
    """Return the last 4×4 matrix of an object: doubles of nine bytes each, by columns."""
    packed = np.frombuffer(meshcat._GetPackedTransform(path)[-16 * 9 :], np.uint8).reshape(16, 9)
    return packed[:, 1:].copy().view(">f8").reshape(4, 4).T
