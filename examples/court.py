"""
A CCTV still: the height of a person, with an interval that can be defended.

    python court.py record.json

Two doors were measured on site with a steel tape, the camera's height too, and its maker tells the
focal length within 3 %. The still is drawn here, so that the truth is known.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from drawn_scene import DrawnCamera, blurred

import imgscale as ims
from imgscale.explaining import explain

path = Path(sys.argv[1] if len(sys.argv) > 1 else Path(tempfile.gettempdir(), "record.json"))

# --- 1. The drawn still; what is known of it below is never quite what is drawn here.

IMAGE_SIZE = (1280, 720)
rng = np.random.default_rng(1)
still = DrawnCamera(IMAGE_SIZE, focal_px=900.0, height_m=2.58, pitch_deg=25.0, roll_deg=0.5)
TRUE_HEIGHT_M = 1.83  # in shoes
things = {  # where they stand (right, up, ahead), their height and width
    "door A": ((-0.7, 0.005, 6.0), 2.029, 0.9),
    "door B": ((0.7, -0.005, 6.0), 2.046, 0.9),
    "suspect": ((0.2, 0.0, 4.6), TRUE_HEIGHT_M, 0.5),
}
BY_HAND = {"box_px": 1.5}  # how much boxes drawn by hand err
detections = [
    ims.Detection(name, blurred(still.box(*thing), rng, **BY_HAND))
    for name, thing in things.items()
]

# --- 2. What was measured, and how well.

priors = ims.PriorTable(
    [
        ims.ObjectPrior("door A", 2.031, 0.003, source="steel tape, mean of three readings"),
        ims.ObjectPrior("door B", 2.043, 0.003, source="steel tape, mean of three readings"),
    ]
)
# The height to the lens, by tape.
ground = ims.GroundPlane(image_size=IMAGE_SIZE, camera_height_m=2.60, camera_height_std_m=0.03)
camera = ims.Camera(912.0, focal_rel_std=0.03, image_size=IMAGE_SIZE)
# The floor is flat within 0.5 % of the camera's height, 13 mm: without being told, the fit allows
# for six times as much, as outdoors.
noise = ims.Noise(**BY_HAND, depth_rel=0.005)

# --- 3. The person's height.

model = ims.fit(detections, ground, priors, camera=camera, noise=noise)
suspect = ims.predict(model, detections)[-1]
low, high = suspect.interval(0.95)
verdict = "inside" if low <= TRUE_HEIGHT_M <= high else "outside"
print(f"The person is {suspect.size_m:.2f} m tall, with 95 % probability {low:.2f} to {high:.2f} m")
print(f"(drawn {TRUE_HEIGHT_M:.2f} m, {verdict}).\n")

# --- 4. The proof: each door is sized as though nobody had measured it.

doors = ims.leave_one_out(detections, ground, priors, camera=camera, noise=noise)[:2]
for door, tape in zip(doors, priors, strict=True):
    shortest, tallest = door.interval(0.95)
    verdict = "agrees with" if shortest <= tape.mean_m <= tallest else "contradicts"
    print(f"{door.label} from the other: 95 % within {shortest:.2f} to {tallest:.2f} m,", end=" ")
    print(f"which {verdict} the tape, {tape.mean_m:.3f} m")

# --- 5. What carried it.

explanation = explain(model, [suspect])
print(f"\n{explanation}\n")

# --- 6. The record: what was given, assumed and found, so that others can repeat it.

record = {
    "imgscale": ims.__version__,
    "model": model.to_dict(),  # priors with their sources, options, each reference's weight
    "explanation": explanation.to_dict(),
    "person": {"height_m": suspect.size_m, "interval_95_m": [low, high]},
    "left_out": [
        {"label": door.label, "height_m": door.size_m, "interval_95_m": door.interval(0.95)}
        for door in doors
    ],
}
path.write_text(json.dumps(record, indent=2), encoding="utf-8")

read = json.loads(path.read_text(encoding="utf-8"))
again = ims.predict(ims.ScaleModel.from_dict(read["model"]), detections)[-1]
print(f"The record is in {path}, written by imgscale {read['imgscale']}.")
for reference in read["model"]["references"]:
    used = f"used, with a weight of {reference['weight']:.2f}"
    print(f"  {reference['label']}: {reference['reason'] or used}")
print(f"Read back, the person is {again.size_m:.2f} m tall.")
