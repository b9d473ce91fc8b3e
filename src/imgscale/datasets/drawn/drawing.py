"""A scene of your own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from imgscale._checks import check_choice, check_type
from imgscale.datasets.drawn._canvas import Canvas
from imgscale.datasets.drawn._floors import GROUNDS, Ground, ground_of
from imgscale.datasets.drawn._gathering import BY_HAND, gather
from imgscale.datasets.drawn._upright import box_of, stand
from imgscale.datasets.drawn.camera import DrawnCamera
from imgscale.datasets.drawn.scene import DrawnScene
from imgscale.datasets.drawn.thing import Thing
from imgscale.noise import Noise
from imgscale.priors import PriorTable

__all__ = ["draw"]


def draw(
    camera: DrawnCamera,
    things: Iterable[Thing],
    *,
    ground: Ground = "plain",
    backdrop: Iterable[Thing] = (),
    priors: PriorTable | None = None,
    rng: np.random.Generator | None = None,
    noise: Noise = BY_HAND,
) -> DrawnScene:
    """
    Draw a scene of your own.

    Parameters
    ----------
    camera : DrawnCamera
        The camera.
    things : iterable of Thing
        What is seen and detected. The nearer ones hide the farther ones; boxes are those of the
        whole things all the same, cut by the picture's border alone.
    ground : str
        "plain", "street" (a road that crosses at 10 to 17 m), "meadow", or "hall" (a room 4.4 m
        wide whose back wall is 6.02 m ahead).
    backdrop : iterable of Thing
        What is seen and not detected.
    priors : PriorTable, optional
        Sizes that are known; the shipped table where omitted.
    rng : numpy Generator, optional
        Moves the boxes' edges; without one boxes are exact.
    noise : Noise
        By how much, where an `rng` is given.

    Returns
    -------
    DrawnScene
        Picture, boxes, depth and truth.

    Raises
    ------
    ValueError
        If a thing is out of view or behind the camera, or the ground unknown.

    Examples
    --------
    >>> from imgscale.datasets.drawn import DrawnCamera, Thing, draw
    >>> camera = DrawnCamera(image_size=(640, 480), focal_px=500.0, height_m=1.5)
    >>> scene = draw(camera, [Thing("door", 0.0, 5.0, 2.0)])
    >>> round(scene.detections[0].height_px, 6), scene.sizes_m, scene.distances_m
    (200.0, (2.0,), (5.0,))
    >>> draw(camera, [Thing("door", 50.0, 5.0, 2.0)])
    Traceback (most recent call last):
        ...
    ValueError: `things` must be in view; the door would be at columns 5276 to 5364, rows 190 to
    390 of 640 x 480.
    """
    check_type("camera", camera, DrawnCamera)
    check_choice("ground", ground, GROUNDS)
    seen = tuple(things)
    canvas = Canvas(camera, *ground_of(camera, ground))
    numbered = [*enumerate(seen), *((-1, thing) for thing in backdrop)]
    for number, thing in sorted(numbered, key=lambda pair: -pair[1].ahead_m):
        stand(canvas, thing, number)
    boxes = [(thing.label, box_of(camera, thing)) for thing in seen]
    feet = [(thing.right_m, thing.up_m, thing.ahead_m) for thing in seen]
    distances = camera.in_camera(np.reshape(feet, (-1, 3)))[:, 2]
    truth = [(thing.height_m, float(z)) for thing, z in zip(seen, distances, strict=True)]
    table = PriorTable.default() if priors is None else priors
    return gather(canvas, boxes, truth, table, noise, rng)
