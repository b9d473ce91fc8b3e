"""What all adapters obey: runners under one law, optional packages asked for where needed."""

import ast
import importlib
import pickle
import pkgutil
import re
import subprocess
import sys
import tomllib
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace

import attrs
import numpy as np
import pytest
import skimage as ski
from PIL import ExifTags, Image, ImageOps

import imgscale as ims
from imgscale import datasets, depth_sources, detectors

ROOT = Path(__file__).resolve().parents[1]
SOURCE = Path(ims.__file__).parent
SIZE = (256, 256)
SEEN = [("person", (70.5, 20.25, 170.0, 250.0)), ("car", (5.0, 5.0, 25.0, 19.0))]


def picture():
    """A person's face and shoulders, in colour."""
    return np.ascontiguousarray(ski.data.astronaut()[:256, 100:356])


def grey(image):
    return np.repeat(image.mean(axis=2).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)


def through_pickle(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301 - our own bytes


# --- stand-ins of what the runners run ---


class Client:
    """What boto3.client("rekognition") is to a runner."""

    def __init__(self, boxes):
        sides = ("Left", "Top", "Width", "Height")
        self.labels = [
            {"Name": name, "Instances": [{"BoundingBox": dict(zip(sides, box, strict=True))}]}
            for name, (x1, y1, x2, y2) in boxes
            for box in [np.divide((x1, y1, x2 - x1, y2 - y1), 256).tolist()]
        ]

    def detect_labels(self, *, Image):  # noqa: N803 - its name there
        assert Image["Bytes"].startswith(b"\xff\xd8")
        return {"Labels": self.labels}


class Inputs(dict):
    def to(self, *_):
        return self


class Processor:
    """An image processor of transformers that knows what comes out."""

    def __init__(self, boxes=()):
        self.boxes = np.array([box for _, box in boxes]).reshape(-1, 4)

    def __call__(self, *, images, return_tensors, input_data_format):
        assert images.dtype == np.uint8
        assert images.ndim == 3
        assert (return_tensors, input_data_format) == ("pt", "channels_last")
        return Inputs(pixel_values=images)

    def post_process_object_detection(self, outputs, *, threshold, target_sizes):
        assert target_sizes == [outputs.shape[:2]]
        scores = np.full(len(self.boxes), 0.75)
        found = {"boxes": self.boxes, "labels": np.arange(len(scores))}
        return [found | {"scores": np.maximum(scores, threshold)}]

    def post_process_depth_estimation(self, outputs, sizes):
        (shape,) = sizes
        assert shape == outputs.shape[:2]
        depth = np.linspace(2, 4, shape[0] * shape[1], dtype=np.float32).reshape(shape)
        return [{"predicted_depth": depth, "focal_length": 300.0}]


class Network:
    """A model of transformers that passes its pixels on."""

    device, dtype = "cpu", "float32"

    def __init__(self, boxes=()):
        names = dict(enumerate(name for name, _ in boxes))
        self.config = SimpleNamespace(model_type="glpn", id2label=names)

    def __call__(self, *, pixel_values):
        return pixel_values


class Results:
    """A result of ultralytics, which an index thins out."""

    masks = None
    orig_shape = SIZE[::-1]

    def __init__(self, xyxy, cls, names):
        conf = np.full(len(xyxy), 0.75)
        self.boxes, self.names = SimpleNamespace(xyxy=xyxy, cls=cls, conf=conf, id=None), names

    def __getitem__(self, index):
        return Results(self.boxes.xyxy[index], self.boxes.cls[index], self.names)


class Yolo:
    """A model of ultralytics that sees the same in every picture."""

    def __init__(self, boxes):
        self.boxes = boxes

    def __call__(self, source, *, conf, verbose):
        assert source.shape == (256, 256, 3)
        assert source.dtype == np.uint8
        assert (conf, verbose) == (0.5, False)
        xyxy = np.array([box for _, box in self.boxes]).reshape(-1, 4)
        names = dict(enumerate(name for name, _ in self.boxes))
        return [Results(xyxy, np.arange(len(xyxy), dtype=np.float64), names)]


class Matcher:
    """OpenCV's matcher of stereo pairs: 8 px everywhere, in sixteenths."""

    def compute(self, left, right):
        assert left.shape == right.shape
        return np.full(left.shape[:2], 8 * 16, dtype=np.int16)


@pytest.fixture(autouse=True)
def stand_ins(monkeypatch):
    torch, cv2 = ModuleType("torch"), ModuleType("cv2")
    torch.inference_mode = nullcontext
    cv2.StereoSGBM_create = lambda **_: Matcher()
    cv2.STEREO_SGBM_MODE_SGBM_3WAY = 2
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "cv2", cv2)


def points():
    """Points 4 m ahead, one in the middle of each pixel."""
    y, x = np.mgrid[:256, :256]
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) * 4.0


# --- runners ---

WRAPPING = {
    "rekognition": lambda boxes: detectors.RekognitionDetector(Client(boxes)),
    "transformers": lambda boxes: detectors.TransformersDetector(
        Network(boxes), Processor(boxes), threshold=0.5
    ),
    "ultralytics": lambda boxes: detectors.UltralyticsDetector(Yolo(boxes), threshold=0.5),
}
DETECTORS = {
    **{name: (lambda make=make: make(SEEN)) for name, make in WRAPPING.items()},
    "face": detectors.FaceDetector,
}
SOURCES = {
    "one distance": lambda: depth_sources.OneDistance(2.0),
    "one unknown distance": depth_sources.OneDistance,
    "on the ground": lambda: depth_sources.OnGround(camera_height_m=1.5, horizon_px=10.0),
    "lidar": lambda: depth_sources.LidarDepth(points(), np.eye(3, 4)),
    "stereo": lambda: depth_sources.StereoDepth(300.0, 0.1).beside(picture()),
    "depth network": lambda: depth_sources.TransformersDepth(Network(), Processor()),
    "depth network with its camera": lambda: (
        depth_sources.TransformersDepth(Network(), Processor()).with_camera
    ),
}


def each(table):
    return pytest.mark.parametrize("make", table.values(), ids=table)


def told(result):
    """Tell what a runner gave in a form that can be compared."""
    if isinstance(result, ims.DepthMap):
        return (result.kind, result.image_size, result.scale_rel_std, result.values.tobytes())
    return tuple(map(told, result)) if isinstance(result, tuple) else result


def beneath(runner):
    """Tell what a method or a partial function is of."""
    return getattr(runner, "__self__", getattr(runner, "func", runner))


def test_every_runner_of_the_package_is_here():
    known = {type(beneath(make())).__name__ for make in (DETECTORS | SOURCES).values()}
    listed = {name for name in detectors.__all__ if name.endswith("Detector")}
    assert known == listed | {name for name in depth_sources.__all__ if name[0].isupper()}


@each(DETECTORS)
@pytest.mark.parametrize("look", [picture, lambda: grey(picture())], ids=["colour", "grey"])
def test_a_detector_gives_a_list_of_what_is_in_the_picture(make, look):
    detector = make()
    assert isinstance(detector, ims.Detector)
    found = detector(look())
    assert type(found) is list
    assert {type(detection) for detection in found} == {ims.Detection}
    for x1, y1, x2, y2 in (detection.xyxy for detection in found):
        assert 0 <= x1 < x2 <= 256
        assert 0 <= y1 < y2 <= 256


@each(WRAPPING)
def test_a_detector_gives_what_its_backend_says(make):
    assert [(d.label, d.xyxy) for d in make(SEEN)(picture())] == SEEN
    assert make([])(picture()) == []


@each(WRAPPING)
def test_a_detector_cuts_boxes_at_the_border_and_drops_those_beyond(make):
    boxes = [
        ("car", (250.0, 10.0, 260.0, 20.0)),
        ("truck", (256.0, 10.0, 262.0, 20.0)),
        ("bus", (-10.0, 10.0, 0.0, 20.0)),
        ("person", (10.0, -2.0, 20.0, 256.0)),
        ("dog", (10.0, 257.0, 20.0, 260.0)),
    ]
    found = make(boxes)(picture())
    inside = [("car", (250.0, 10.0, 256.0, 20.0)), ("person", (10.0, 0.0, 20.0, 256.0))]
    assert [(d.label, d.xyxy) for d in found] == inside


@each(WRAPPING)
def test_a_detector_drops_a_box_however_far_outside(make):
    for box in ((400.0, 10.0, 420.0, 20.0), (-90.0, 10.0, -60.0, 20.0)):
        found = make([("dog", box), SEEN[0]])(picture())
        assert [(d.label, d.xyxy) for d in found] == SEEN[:1]


@each(WRAPPING)
def test_a_detector_drops_a_box_without_area_and_keeps_those_beside_it(make):
    flat = [
        ("truck", (10.0, 20.0, 10.0, 70.0)),
        ("bus", (10.0, 20.0, 50.0, 20.0)),
        ("dog", (0.0, 0.0, 0.0, 0.0)),
        ("cat", (-10.0, 30.0, 20.0, 30.0)),
        ("cow", (256.0, 10.0, 256.0, 20.0)),
    ]
    for box in flat:
        found = make([SEEN[0], box, SEEN[1]])(picture())
        assert [(d.label, d.xyxy) for d in found] == SEEN
    assert make(flat)(picture()) == []


@each(WRAPPING)
def test_a_detector_does_not_drop_a_box_that_is_no_number(make):
    with pytest.raises(ValueError, match=r"\[2\]"):
        make([*SEEN, ("dog", (np.nan, 10.0, 20.0, 30.0))])(picture())


@each(SOURCES)
@pytest.mark.parametrize("look", [picture, lambda: grey(picture())], ids=["colour", "grey"])
def test_a_depth_source_gives_depth_of_the_pictures_size(make, look):
    source = make()
    assert isinstance(source, ims.DepthSource)
    depth = source(look()[:, :])
    if isinstance(depth, tuple):
        depth, camera = depth
        assert camera.image_size == SIZE
    assert isinstance(depth, (ims.DepthMap, ims.GroundPlane))
    assert depth.image_size == SIZE


@each(DETECTORS | SOURCES)
def test_a_runner_leaves_the_picture_as_it_was(make):
    image = picture()
    make()(image)
    assert np.array_equal(image, picture())


@each(DETECTORS | SOURCES)
def test_a_runner_takes_pictures_that_are_read_only_or_views(make):
    runner, image = make(), picture()
    expected = told(runner(image))
    image.flags.writeable = False
    assert told(runner(image)) == expected
    assert told(runner(np.asfortranarray(image))) == expected
    assert told(runner(ski.data.astronaut()[:256, 100:356])) == expected
    assert told(runner(image[:, ::-1].copy()[:, ::-1])) == expected


@each(DETECTORS | SOURCES)
def test_a_runner_travels_to_other_processes(make):
    runner = make()
    assert told(through_pickle(runner)(picture())) == told(runner(picture()))


@each(DETECTORS | SOURCES)
def test_a_runner_does_not_change(make):
    runner = beneath(make())
    for name in attrs.fields_dict(type(runner)):
        with pytest.raises(attrs.exceptions.FrozenInstanceError):
            setattr(runner, name, None)


WRAPPERS = WRAPPING | {
    "depth network": lambda _: depth_sources.TransformersDepth(Network(), Processor())
}


@each(WRAPPERS)
def test_a_runner_is_equal_to_itself_alone_and_does_not_print_what_it_wraps(make):
    runner = make(SEEN)
    assert runner == runner  # noqa: PLR0124 - nothing of the backend is compared
    assert runner != make(SEEN)
    assert len({runner, make(SEEN)}) == 2
    assert " object at 0x" not in repr(runner)


@each(DETECTORS)
def test_a_detector_serves_measure(make):
    result = ims.measure(
        picture(),
        detector=make(),
        depth_source=lambda _: ims.DepthMap([[2.0]], kind="relative", image_size=SIZE),
    )
    assert list(result.detections) == make()(picture())
    assert all(estimate.size_m > 0 for estimate in result.estimates)


@each(SOURCES)
def test_a_depth_source_serves_measure(make):
    seen = [ims.Detection("person", (100, 40, 150, 200)), ims.Detection("box", (20, 150, 60, 190))]
    result = ims.measure(picture(), detector=lambda _: seen, depth_source=make())
    person, box = result.estimates
    assert 1 < person.size_m < 3
    assert 0.1 < box.size_m < 3


class NoPicture:
    """Has nothing of a picture."""


@each(DETECTORS | SOURCES)
@pytest.mark.parametrize(
    "image",
    [
        pytest.param(None, id="None"),
        pytest.param([[[0, 0, 0]]], id="a list"),
        pytest.param(NoPicture(), id="an object"),
        pytest.param(np.zeros((0, 256, 3), dtype=np.uint8), id="without a pixel"),
        pytest.param(np.zeros(256, dtype=np.uint8), id="a row"),
        pytest.param(np.zeros((1, 256, 256, 3), dtype=np.uint8), id="a batch"),
    ],
)
def test_what_is_no_picture_is_refused_by_name(make, image):
    with pytest.raises((ValueError, TypeError), match=r"`(image|image_size|left)` must"):
        make()(image)


@each(DETECTORS)
@pytest.mark.parametrize(
    "image",
    [
        pytest.param(np.zeros((256, 256, 3)), id="floats"),
        pytest.param(np.zeros((256, 256, 4), dtype=np.uint8), id="with an alpha channel"),
        pytest.param(np.zeros((3, 256, 256), dtype=np.uint8), id="channels first"),
    ],
)
def test_a_detector_refuses_pictures_of_another_form_by_name(make, image):
    with pytest.raises((ValueError, TypeError), match="`image` must"):
        make()(image)


@each(WRAPPING)
def test_a_detector_does_not_take_the_columns_of_a_grey_picture_for_its_channels(make):
    with pytest.raises((ValueError, TypeError), match="`image` must"):
        make(SEEN)(np.zeros((256, 256), dtype=np.uint8))


MAKERS = {
    "rekognition: client": detectors.RekognitionDetector,
    "transformers: model": lambda it: detectors.TransformersDetector(
        it, Processor(), threshold=0.5
    ),
    "transformers: image_processor": lambda it: detectors.TransformersDetector(
        Network(), it, threshold=0.5
    ),
    "ultralytics: model": lambda it: detectors.UltralyticsDetector(it, threshold=0.5),
    "depth network: model": lambda it: depth_sources.TransformersDepth(it, Processor()),
    "depth network of a told kind: model": lambda it: depth_sources.TransformersDepth(
        it, Processor(), kind="metric"
    ),
    "depth network: image_processor": lambda it: depth_sources.TransformersDepth(Network(), it),
}


@pytest.mark.parametrize("named", MAKERS)
@pytest.mark.parametrize("nothing", [None, 7, "model"])
def test_a_runner_of_nothing_is_not_made(named, nothing):
    _, _, argument = named.partition(": ")
    with pytest.raises(TypeError, match=f"`{argument}` must"):
        MAKERS[named](nothing)


@each(DETECTORS | SOURCES)
def test_a_picture_that_is_no_array_is_refused_by_name_or_turned_upright(make):
    lying = Image.fromarray(np.rot90(picture()))
    lying.getexif()[ExifTags.Base.Orientation] = 6
    assert np.array_equal(ImageOps.exif_transpose(lying), picture())
    try:
        result = make()(lying)
    except (TypeError, ValueError) as error:
        message = str(error)
    else:
        message = "" if told(result) == told(make()(picture())) else "another picture"
    assert message == "" or re.match(r"`(image|left)` must", message)


# --- optional packages ---

HEAVY = ("torch", "transformers", "supervision", "cv2", "boto3", "skimage.feature", "pandas")


def modules():
    """Name every module that an adapter or a data set lives in."""
    return [
        f"{package.__name__}.{module.name}"
        for package in (detectors, depth_sources, datasets)
        for module in pkgutil.iter_modules(package.__path__)
    ]


def test_importing_all_adapters_and_datasets_loads_nothing_heavy():
    code = (
        f"import importlib, sys\nfor name in {modules()}: importlib.import_module(name)\n"
        f"print(*(name for name in {(*HEAVY, 'matplotlib')} if name in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def required():
    """Find every call of `require`: its file, module and extra."""
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "require":
                options = {option.arg: option.value for option in node.keywords}
                module = ast.literal_eval(node.args[0])
                where = path.relative_to(SOURCE).as_posix()
                yield where, module, ast.literal_eval(options["extra"])


DISTRIBUTIONS = {"cv2": "opencv-python-headless"}


@pytest.mark.parametrize(("where", "module", "extra"), sorted(set(required())))
def test_an_extra_that_is_asked_for_exists_and_brings_the_package(where, module, extra):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    package = module.partition(".")[0]
    brought = [re.split(r"[^\w.-]", need)[0] for need in project["optional-dependencies"][extra]]
    assert DISTRIBUTIONS.get(package, package) in brought, where


def from_boxes():
    return detectors.to_supervision([ims.Detection("car", (10, 20, 110, 70))])


def from_map():
    return depth_sources.to_supervision(ims.DepthMap([[2.5]], kind="metric"))


def stereo_pair():
    return depth_sources.stereo_disparity(picture(), picture())


ABSENT = {
    "stereo disparity": (stereo_pair, "cv2", "stereo"),
    "stereo depth": (lambda: SOURCES["stereo"]()(picture()), "cv2", "stereo"),
    "boxes to supervision": (from_boxes, "supervision", "supervision"),
    "maps to supervision": (from_map, "supervision", "supervision"),
    "detector of transformers": (
        lambda: DETECTORS["transformers"]()(picture()),
        "torch",
        "transformers",
    ),
    "depth of transformers": (
        lambda: SOURCES["depth network"]()(picture()),
        "torch",
        "transformers",
    ),
}


@pytest.mark.parametrize(("call", "module", "extra"), ABSENT.values(), ids=ABSENT)
def test_where_a_package_is_absent_the_message_is_its_installation(
    call, module, extra, monkeypatch
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ims.MissingDependencyError) as caught:
        call()
    told_so = f"needs the optional package '{module}'; install it with `pip install"
    assert str(caught.value).endswith(f"{told_so} 'imgscale[{extra}]'`.")


def test_every_adapter_that_needs_a_package_is_tried_without_it():
    adapters = ("detectors/", "depth_sources/")
    needed = {(module, extra) for where, module, extra in required() if where.startswith(adapters)}
    assert needed == {(module, extra) for _, module, extra in ABSENT.values()}


@pytest.mark.parametrize("name", [name for name in modules() if "._" not in name])
def test_every_adapter_module_says_what_it_gives(name):
    module = importlib.import_module(name)
    public = {
        key for key, value in vars(module).items() if getattr(value, "__module__", "") == name
    }
    assert {key for key in public if not key.startswith("_")} <= set(module.__all__)
