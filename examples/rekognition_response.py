"""
Sizes from a response of Amazon Rekognition
===========================================

`from_rekognition` reads what DetectLabels answers. Boxes there are ratios of the picture, one thing
comes under several names, and names without a box are scenes. Boxes are all that is needed here:
people and cars of known height stand on the same ground as the statue.
"""

import matplotlib.pyplot as plt

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.detectors import from_rekognition
from imgscale.plotting import draw_sizes

# %%
# The answer for a drawn street, shortened to what is read. Yours comes from
# ``boto3.client("rekognition").detect_labels(Image=...)``, or as JSON from the command line.

street = drawn.street()
size = width, height = street.depth.image_size
sides = ("Left", "Top", "Width", "Height")
boxes = []
for x1, y1, x2, y2 in (thing.xyxy for thing in street.detections):
    ratios = (x1 / width, y1 / height, (x2 - x1) / width, (y2 - y1) / height)
    boxes.append({"BoundingBox": dict(zip(sides, ratios, strict=True)), "Confidence": 97.3})
one, two, three, coupe, other, statue = boxes
vehicles = [{"Name": "Vehicle"}, {"Name": "Transportation"}]
response = {
    "Labels": [
        {"Name": "Person", "Instances": [one, two, three], "Aliases": [{"Name": "Human"}]},
        {"Name": "Woman", "Instances": [two], "Parents": [{"Name": "Person"}]},
        {"Name": "Car", "Instances": [coupe, other], "Parents": vehicles},
        {"Name": "Coupe", "Instances": [coupe], "Parents": [{"Name": "Car"}, *vehicles]},
        {"Name": "Statue", "Instances": [statue], "Parents": [{"Name": "Art"}]},
        {"Name": "Road", "Confidence": 93.5, "Instances": []},
    ]
}

# %%
# Six things, each with its names: the most telling first, the others as aliases. The table of sizes
# is asked for them in turn: it knows no coupe, but a car.

detections = from_rekognition(response, image_size=size)
model = ims.fit(detections, ims.GroundPlane(image_size=size))
for thing, reference in zip(detections, model.references, strict=True):
    known = f"known as {reference.prior_label}" if reference.used else reference.reason
    print(f"{', '.join(thing.names):20} {known}")

# %%
# The statue was drawn 2.6 m high.

sizes = ims.predict(model, detections)
print(*sizes, sep="\n")
fig, ax = plt.subplots(figsize=(9.6, 5.4), layout="constrained")
draw_sizes(street.image, detections, sizes, ax=ax)
