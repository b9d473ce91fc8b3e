"""Scenes that are ready: a street, a camera trap, a hallway, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imgscale.datasets.drawn._canvas import Canvas
from imgscale.datasets.drawn._floors import table_of
from imgscale.datasets.drawn._gathering import BY_HAND, gather
from imgscale.datasets.drawn._lying import Lying, lay, lying_box
from imgscale.datasets.drawn._silhouettes import WHITE
from imgscale.datasets.drawn._upright import box_of
from imgscale.datasets.drawn.camera import DrawnCamera
from imgscale.datasets.drawn.drawing import draw
from imgscale.datasets.drawn.scene import DrawnScene
from imgscale.datasets.drawn.thing import Thing
from imgscale.noise import Noise
from imgscale.object_prior import ObjectPrior
from imgscale.priors import PriorTable

__all__ = ["camera_trap", "camera_trap_poles", "hallway", "street", "table_top"]


def street(*, rng: np.random.Generator | None = None, noise: Noise = BY_HAND) -> DrawnScene:
    """
    Draw a street: three people, two cars, and a statue of unknown height.

    The camera is 1.6 m up and looks 4 degrees down. The shipped table of priors knows people and
    cars, not the statue, which is 2.6 m high.

    Parameters
    ----------
    rng : numpy Generator, optional
        Moves the boxes' edges; without one boxes are exact.
    noise : Noise
        By how much, where an `rng` is given.

    Returns
    -------
    DrawnScene
        960 x 540 pixels. The statue is the last detection.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import drawn
    >>> scene = drawn.street()
    >>> model = ims.fit(scene.detections, scene.depth_as("relative"), scene.priors)
    >>> low, high = ims.predict(model, scene.detections, scene.depth_as("relative"))[-1].interval()
    >>> low < scene.sizes_m[-1] < high
    True
    """
    camera = DrawnCamera(image_size=(960, 540), focal_px=820.0, height_m=1.6, pitch_deg=4.0)
    things = [
        Thing("person", -0.86, 5.2, 1.74, colour=(0.24, 0.42, 0.66)),
        Thing("person", 1.79, 7.0, 1.63, colour=(0.68, 0.32, 0.36)),
        Thing("person", -1.07, 17.6, 1.81, colour=(0.38, 0.44, 0.30)),
        Thing("car", -4.64, 12.0, 1.46),
        Thing("car", 7.02, 16.0, 1.57, colour=(0.30, 0.44, 0.58), mirrored=True),
        Thing("statue", 1.04, 9.0, 2.6),
    ]
    backdrop = [
        Thing("house", x, 34.0, height, colour=colour)
        for x, height, colour in ((-15.5, 8.6, (0.88, 0.82, 0.70)), (-5.0, 7.9, (0.80, 0.72, 0.66)),
                                  (9.0, 8.3, (0.84, 0.80, 0.76)), (19.5, 7.6, (0.86, 0.77, 0.62)))
    ]  # fmt: skip
    backdrop += [
        Thing("tree", x, ahead, height)
        for x, ahead, height in ((-9.5, 26.0, 5.4), (8.3, 28.0, 5.0), (14.6, 24.0, 5.8))
    ]
    return draw(camera, things, ground="street", backdrop=backdrop, rng=rng, noise=noise)


_TRAP = DrawnCamera(
    image_size=(960, 540), focal_px=700.0, height_m=0.9, pitch_deg=4.0, roll_deg=0.6
)
_DETECTOR = Noise(box_px=1.0, box_rel=0.03)
_POLE = PriorTable([ObjectPrior("pole", 1.0, 0.002, source="checked with a steel tape")])
_UNEVEN_M = 0.02  # how far the meadow is from level: grass and dips
_SPECIES: Mapping[str, tuple[float, float]] = {  # mean height and spread between animals, metres
    "roe deer": (0.92, 0.09),
    "wild boar": (0.78, 0.09),
    "fox": (0.44, 0.04),
}
_WOOD = tuple(
    Thing("tree", x, ahead, height)
    for x, ahead, height in ((-16.0, 30.0, 6.2), (-10.5, 36.0, 6.6), (-3.0, 40.0, 7.2),
                             (4.0, 34.0, 5.8), (11.5, 38.0, 7.0), (18.0, 32.0, 6.0))
)  # fmt: skip


def camera_trap_poles(
    *, rng: np.random.Generator | None = None, noise: Noise = _DETECTOR
) -> DrawnScene:
    """
    Draw the set-up day of a camera trap: one pole of 1 m, carried to twelve places.

    Twelve pictures of one fixed camera are laid over each other.

    Parameters
    ----------
    rng : numpy Generator, optional
        Moves the boxes' edges, and the feet by 2 cm; without one both are exact.
    noise : Noise
        Errors of the boxes, where an `rng` is given.

    Returns
    -------
    DrawnScene
        960 x 540 pixels, of a camera 0.9 m up.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import drawn
    >>> scene = drawn.camera_trap_poles()
    >>> model = ims.fit(scene.detections, ims.GroundPlane(image_size=(960, 540)), scene.priors)
    >>> round(model.camera_height_m, 1)
    0.9
    """
    places = [  # shifted from row to row, so that none hides another
        ((side + shift) * ahead, ahead)
        for ahead, shift in ((3.0, -0.08), (5.0, -0.02), (8.0, 0.03), (12.0, 0.07))
        for side in (-0.4, 0.0, 0.4)
    ]
    poles = [
        Thing("pole", right, ahead, 1.0, up_m=rng.normal(0.0, _UNEVEN_M) if rng else 0.0)
        for right, ahead in places
    ]
    return _trapped(poles, rng, noise)


def camera_trap(*, rng: np.random.Generator | None = None, noise: Noise = _DETECTOR) -> DrawnScene:
    """
    Draw a picture by the camera trap of `camera_trap_poles`: a roe deer, a wild boar, foxes.

    Parameters
    ----------
    rng : numpy Generator, optional
        Draws one to three animals of any size anywhere in view, on ground uneven by 2 cm, and moves
        the boxes' edges; without one there is one fixed picture with exact boxes.
    noise : Noise
        Errors of the boxes, where an `rng` is given.

    Returns
    -------
    DrawnScene
        960 x 540 pixels; its priors are those of the pole.

    Examples
    --------
    >>> from imgscale.datasets import drawn
    >>> [animal.label for animal in drawn.camera_trap().detections]
    ['roe deer', 'wild boar', 'fox']
    """
    animals = [
        Thing("roe deer", -1.6, 6.0, 0.95),
        Thing("wild boar", 1.9, 7.5, 0.78, mirrored=True),
        Thing("fox", 0.6, 3.6, 0.42, mirrored=True),
    ]
    if rng is not None:
        animals = _some_animals(rng)
    return _trapped(animals, rng, noise)


def _trapped(things: Sequence[Thing], rng: np.random.Generator | None, noise: Noise) -> DrawnScene:
    """Draw what stands before the camera trap."""
    return draw(_TRAP, things, ground="meadow", backdrop=_WOOD, priors=_POLE, rng=rng, noise=noise)


def _some_animals(rng: np.random.Generator) -> list[Thing]:
    """Put one to three animals where they are in full view and do not hide each other."""
    animals: list[Thing] = []
    taken: list[tuple[float, float]] = []
    width, height = _TRAP.image_size
    wanted = int(rng.integers(1, 4))
    while len(animals) < wanted:
        species = str(rng.choice(list(_SPECIES)))
        size = max(float(rng.normal(*_SPECIES[species])), 0.2)
        ahead = float(rng.uniform(2.5, 14.0))
        right, up = ahead * float(rng.uniform(-0.6, 0.6)), float(rng.normal(0.0, _UNEVEN_M))
        mirrored = bool(rng.random() < 0.5)
        animal = Thing(species, right, ahead, size, up_m=up, mirrored=mirrored)
        x1, y1, x2, y2 = box_of(_TRAP, animal)
        is_free = all(x2 < left or right < x1 for left, right in taken)
        if is_free and min(x1, y1) > 8 and x2 < width - 8 and y2 < height - 8:
            animals.append(animal)
            taken.append((x1, x2))
    return animals


def hallway(*, rng: np.random.Generator | None = None, noise: Noise = BY_HAND) -> DrawnScene:
    """
    Draw a CCTV still: a person before two doors that were measured on site.

    The camera is 2.58 m up and looks 25 degrees down, with a roll of half a degree; one door's foot
    is 5 mm above, the other's 5 mm below the floor.

    Parameters
    ----------
    rng : numpy Generator, optional
        Moves the boxes' edges; without one boxes are exact.
    noise : Noise
        By how much, where an `rng` is given.

    Returns
    -------
    DrawnScene
        1280 x 720 pixels: "door A", "door B" and "person". Its priors are the doors, as a steel
        tape found them, 2 and 3 mm off.

    Examples
    --------
    >>> from imgscale.datasets import drawn
    >>> drawn.hallway().sizes_m
    (2.029, 2.046, 1.83)
    """
    camera = DrawnCamera(
        image_size=(1280, 720), focal_px=900.0, height_m=2.58, pitch_deg=25.0, roll_deg=0.5
    )
    things = [
        Thing("door A", -1.0, 6.0, 2.029, width_m=0.9, up_m=0.005, shape="door"),
        Thing("door B", 1.0, 6.0, 2.046, width_m=0.9, up_m=-0.005, shape="door"),
        Thing("person", 0.05, 4.6, 1.83, colour=(0.36, 0.38, 0.42)),
    ]
    tape = "steel tape, mean of three readings"
    doors = [
        ObjectPrior("door A", 2.031, 0.003, source=tape),
        ObjectPrior("door B", 2.043, 0.003, source=tape),
    ]
    return draw(camera, things, ground="hall", priors=PriorTable(doors), rng=rng, noise=noise)


def table_top(*, rng: np.random.Generator | None = None, noise: Noise = BY_HAND) -> DrawnScene:
    """
    Draw a table from straight above: a coin, a biscuit and fruit.

    The camera is 0.55 m above the table. The coin and the biscuit are flat; the fruit are balls,
    whose widest part is nearer to the camera, and which so look larger, the apple by 7 %.

    Parameters
    ----------
    rng : numpy Generator, optional
        Moves the boxes' edges; without one boxes are exact.
    noise : Noise
        By how much, where an `rng` is given.

    Returns
    -------
    DrawnScene
        900 x 675 pixels: "2 euro coin", "biscuit", "apple", "orange" and "plum". Its only prior is
        the coin's, from the shipped table.

    Examples
    --------
    >>> from imgscale.datasets import drawn
    >>> scene = drawn.table_top()
    >>> [f"{thing.label} {1000 * size:g} mm"
    ...  for thing, size in zip(scene.detections, scene.sizes_m, strict=True)]
    ['2 euro coin 25.75 mm', 'biscuit 68 mm', 'apple 78 mm', 'orange 84 mm', 'plum 46 mm']
    """
    camera = DrawnCamera(image_size=(900, 675), focal_px=1100.0, height_m=0.55, pitch_deg=90.0)
    things = [
        Lying("2 euro coin", -0.035, -0.015, 0.02575, WHITE, (0.82, 0.70, 0.40), 0.0022),
        Lying("biscuit", 0.035, -0.085, 0.068, (0.82, 0.62, 0.36), (0.86, 0.68, 0.42), 0.007),
        Lying("apple", -0.115, 0.055, 0.078, (0.78, 0.20, 0.16)),
        Lying("orange", 0.105, 0.045, 0.084, (0.95, 0.58, 0.16)),
        Lying("plum", -0.10, -0.075, 0.046, (0.42, 0.24, 0.46)),
    ]  # fmt: skip
    canvas = Canvas(camera, *table_of(camera))
    lay(canvas, things)
    boxes = [(thing.label, lying_box(camera, thing)) for thing in things]
    truth = [(thing.diameter_m, camera.height_m - thing.widest_m) for thing in things]
    coin = PriorTable(PriorTable.default().lookup("2 euro coin"))
    return gather(canvas, boxes, truth, coin, noise, rng)
