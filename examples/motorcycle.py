"""
Size the things in a real photo from its one object of known size.

The depth is the raw disparity of a stereo pair, taken as inverse depth. The published baseline of
this pair is not used: the fit finds it, and finds another.
"""

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.plotting import draw_sizes

scene = motorcycle.load()
depth = ims.DepthMap(scene.shifted_disparity, kind="inverse")

# A tyre 120/90-16 is 16 inches of rim and twice 90 % of 120 mm; wear and load are the spread.
tyre = ims.ObjectPrior("rear tyre", 0.622, 0.012)

model = ims.fit(
    scene.detections,
    depth,
    ims.PriorTable([tyre]),
    camera=scene.camera,  # for distances
    noise=ims.Noise(box_px=1.5, depth_rel=0.01),
)
print(model)
print(f"published baseline {motorcycle.PUBLISHED_BASELINE_M:.3f} m, found {model.k:.3f} m\n")

sizes = ims.predict(model, scene.detections, depth)
for size in sizes:
    low, high = size.interval(0.9)
    print(f"{size.label:12} {size.size_m:.3f} m, 90 % within {low:.3f} to {high:.3f} m")

draw_sizes(scene.image, scene.detections, sizes).figure.savefig("imgscale_demo.png")
