"""
A camera trap: heights and distances of animals from one pole of 1 m, without any depth map.

    python fixed_camera.py animals.csv

On the day the camera is put up, somebody carries a pole through the scene. A camera that does not
move sees one ground plane: all pictures of the pole are fitted together, as though they were one
image, and every later picture is measured by what they tell. The scene is drawn here, so that the
truth is known.
"""

import csv
import json
import math
import sys
import tempfile
from pathlib import Path
from statistics import median

import numpy as np
from drawn_scene import DrawnCamera, draw_animals, draw_poles

import imgscale as ims

csv_path = Path(sys.argv[1] if len(sys.argv) > 1 else Path(tempfile.gettempdir(), "animals.csv"))

# --- The drawn scene stands for your pictures and your detector, whose boxes err by so much.

IMAGE_SIZE = (1920, 1080)
DETECTOR = {"box_px": 2.0, "box_rel": 0.03}
rng = np.random.default_rng(7)
trap = DrawnCamera(IMAGE_SIZE, focal_px=1400.0, height_m=0.9, pitch_deg=4.0, roll_deg=0.6)
poles = draw_poles(trap, rng, **DETECTOR)
pictures = [draw_animals(trap, rng, **DETECTOR) for _ in range(40)]

# --- Set-up day: the pole at twelve places, one fit.

FOCAL_PX = 1420.0  # by the maker, within 2 %; distances need it, heights hardly
model = ims.fit(
    poles,
    ims.GroundPlane(image_size=IMAGE_SIZE),
    ims.PriorTable([ims.ObjectPrior("pole", 1.0, 0.002, source="checked with a steel tape")]),
    camera=ims.Camera(FOCAL_PX, focal_rel_std=0.02, image_size=IMAGE_SIZE),
    noise=ims.Noise(**DETECTOR),
)
plane = model.plane
print(model)
print(
    f"camera height {plane.camera_height_m:.2f} +- {plane.camera_height_std_m:.2f} m "
    f"(drawn: {trap.height_m:.2f} m)"
)
print(
    f"horizon in row {plane.horizon_px:.0f} +- {plane.horizon_std_px:.0f} "
    f"(drawn: {trap.horizon_px:.0f})\n"
)

# Keep this text with the pictures: it is all that is needed to measure the later ones.
saved = json.dumps(model.to_dict())

# --- Any day after: boxes alone.


def over_ground_m(size: ims.SizeEstimate, detection: ims.Detection) -> float:
    """
    Turn the distance along the camera's axis into that over the ground, as with a tape.

    At the edge of a picture the two differ by a fifth.
    """
    x1, _, x2, y2 = detection.xyxy
    sideways = ((x1 + x2) / 2 - IMAGE_SIZE[0] / 2) / FOCAL_PX
    downward = (y2 - IMAGE_SIZE[1] / 2) / FOCAL_PX
    to_foot_m = size.distance_m * math.hypot(1.0, sideways, downward)
    return math.sqrt(max(to_foot_m**2 - plane.camera_height_m**2, 0.0))


kept = ims.ScaleModel.from_dict(json.loads(saved))
rows, inside, height_errors, distance_errors = [], [], [], []
for number, animals in enumerate(pictures, start=1):
    sizes = ims.predict(kept, [animal.detection for animal in animals])
    for animal, size in zip(animals, sizes, strict=True):
        low, high = size.interval(0.9)
        distance = over_ground_m(size, animal.detection)
        metres = [f"{value:.2f}" for value in (size.size_m, low, high, distance)]
        rows.append([number, size.label, *metres, size.flags.name or ""])
        inside.append(low <= animal.height_m <= high)
        height_errors.append(abs(size.size_m / animal.height_m - 1))
        distance_errors.append(abs(distance / animal.distance_m - 1))

with csv_path.open("w", newline="", encoding="utf-8") as file:
    writer = csv.writer(file)
    writer.writerow(["picture", "label", "height_m", "low_m", "high_m", "distance_m", "flags"])
    writer.writerows(rows)

print(*csv_path.read_text(encoding="utf-8").splitlines()[:6], "...", sep="\n")
print(f"\n{len(rows)} animals of {len(pictures)} pictures in {csv_path}")
print(f"{sum(inside)} of {len(rows)} true heights are in their 90 % intervals")
print(
    f"median error: height {100 * median(height_errors):.1f} %, "
    f"distance {100 * median(distance_errors):.1f} %"
)
