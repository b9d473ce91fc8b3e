"""COCO's annotations and results: boxes, masks and what is refused, by its own tools where here."""

import copy
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import skimage as ski
from hypothesis import given, settings
from hypothesis import strategies as st

from imgscale.detectors.coco import from_coco, read_coco

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
COCO = DATA / "detector_outputs" / "coco"
ANNOTATIONS = COCO / "sahi_coco_evaluate_dataset.json"
RESULTS = COCO / "cocoapi_instances_val2014_fakebbox100_results.json"

needs_files = pytest.mark.skipif(not ANNOTATIONS.is_file(), reason=f"no COCO files in {COCO}")

# Written by pycocotools 2.0.11: encode(m) of the mask m of 7 rows and 9 columns whose rows 2 to 4
# of columns 3 to 6 and whose last pixel are set.
COMPRESSED = {"size": [7, 9], "counts": "g03400000;N"}


def dataset(*annotations, **image):
    return {
        "images": [{"id": 7, "file_name": "street.jpg", "width": 640, "height": 480} | image],
        "categories": [
            {"id": 1, "name": "person", "supercategory": "person"},
            {"id": 3, "name": "car", "supercategory": "vehicle"},
        ],
        "annotations": list(annotations),
    }


def entry(**members):
    return {"image_id": 7, "category_id": 3, "bbox": [10, 20, 100, 50]} | members


def only(*annotations, masks=False, **image):
    (found,) = from_coco(dataset(*annotations, **image), masks=masks).values()
    return found


def write_json(folder, name, content):
    path = folder / name
    path.write_text(json.dumps(content))
    return path


# --- boxes, names and pictures ---


def test_an_annotation_is_a_detection_of_its_category():
    (car,) = only(entry(bbox=[10.5, 20.25, 100.5, 50.25]))
    assert car.label == "car"
    assert car.xyxy == (10.5, 20.25, 111.0, 70.5)
    assert (car.score, car.partial, car.mask) == (1.0, False, None)


def test_results_take_the_place_of_the_annotations():
    truth, seen = entry(category_id=1), entry(score=0.75)
    (car,) = from_coco(dataset(truth), [seen])["street.jpg"]
    assert (car.label, car.score) == ("car", 0.75)


def test_results_need_no_annotations():
    bare = dataset()
    del bare["annotations"]
    assert len(from_coco(bare, [entry(score=0.5)])["street.jpg"]) == 1


def test_pictures_without_detections_have_an_empty_list():
    pictures = dataset(entry())
    pictures["images"].append({"id": "b", "file_name": "empty.jpg"})
    assert [len(found) for found in from_coco(pictures).values()] == [1, 0]
    assert from_coco(dataset(), []) == {"street.jpg": []}


def test_detections_keep_the_order_of_the_file_within_their_picture():
    pictures = dataset(*[entry(image_id=7 + i % 2, bbox=[i, 0, 5, 5]) for i in range(6)])
    pictures["images"].append({"id": 8, "file_name": "b.jpg"})
    found = from_coco(pictures)
    assert [d.xyxy[0] for d in found["street.jpg"]] == [0, 2, 4]
    assert [d.xyxy[0] for d in found["b.jpg"]] == [1, 3, 5]


def test_a_crowd_is_kept_and_never_a_reference():
    assert [d.partial for d in only(entry(iscrowd=1), entry(iscrowd=0), entry())] == [
        True,
        False,
        False,
    ]


def test_a_theme_or_a_projects_name_is_no_other_name_of_the_object():
    assert only(entry())[0].aliases == ()


@pytest.mark.parametrize("length", [None, 0, -1])
def test_a_picture_of_unknown_size_does_not_cut_its_boxes(length):
    (car,) = only(entry(bbox=[600, 20, 100, 50]), width=length)
    assert car.xyxy == (600, 20, 700, 70)


def test_a_known_border_cuts_boxes_that_reach_a_little_beyond_it():
    (car,) = only(entry(bbox=[-2, 440, 650, 41.5]))
    assert car.xyxy == (0, 440, 640, 480)


def test_the_input_is_not_written_to():
    content = dataset(entry(segmentation=[[10, 20, 30, 20, 30, 40]]))
    before = copy.deepcopy(content)
    from_coco(content, masks=True)
    assert content == before


@needs_files
def test_every_box_of_a_real_annotation_file_is_the_one_written_there():
    content = json.loads(ANNOTATIONS.read_text())
    found = read_coco(ANNOTATIONS)
    files = {image["id"]: image["file_name"] for image in content["images"]}
    names = {category["id"]: category["name"] for category in content["categories"]}
    for number, file in files.items():
        written = [a for a in content["annotations"] if a["image_id"] == number]
        assert [d.label for d in found[file]] == [names[a["category_id"]] for a in written]
        for detection, annotation in zip(found[file], written, strict=True):
            size = (detection.width_px, detection.height_px)
            assert (*detection.xyxy[:2], *size) == tuple(annotation["bbox"])
    assert sum(map(len, found.values())) == 249


@needs_files
def test_a_real_results_file_is_read_with_a_list_of_its_pictures(tmp_path):
    results = json.loads(RESULTS.read_text())
    pictures = {
        "images": [{"id": i, "file_name": f"{i}"} for i in {r["image_id"] for r in results}],
        "categories": [{"id": i, "name": f"class {i}"} for i in range(1, 91)],
    }
    found = read_coco(write_json(tmp_path, "pictures.json", pictures), RESULTS)
    assert sum(map(len, found.values())) == len(results) == 734
    first = found["42"][0]
    assert (first.label, first.score) == ("class 18", 0.236)
    assert first.xyxy == pytest.approx((258.15, 41.29, 258.15 + 348.26, 41.29 + 243.78))


@needs_files
def test_pycocotools_reads_the_same_boxes_from_a_real_file(capsys):
    tools = pytest.importorskip("pycocotools.coco")
    theirs = tools.COCO(str(ANNOTATIONS))
    capsys.readouterr()  # it prints
    for image in theirs.loadImgs(theirs.getImgIds()):
        written = theirs.loadAnns(theirs.getAnnIds(imgIds=[image["id"]]))
        ours = read_coco(ANNOTATIONS)[image["file_name"]]
        assert [list(d.xyxy[:2]) for d in ours] == [a["bbox"][:2] for a in written]


# --- masks ---


def test_masks_are_made_only_where_they_are_asked_for():
    polygon = entry(segmentation=[[10, 20, 30, 20, 30, 40]])
    assert only(polygon)[0].mask is None
    assert only(polygon, masks=True)[0].mask is not None


def test_a_rectangle_between_pixels_covers_exactly_its_pixels():
    outline = [10, 20, 14, 20, 14, 23, 10, 23]
    (car,) = only(entry(bbox=[10, 20, 4, 3], segmentation=[outline]), masks=True)
    assert car.mask.shape == (480, 640)
    assert {(20, 10), (22, 13)} <= set(zip(*np.nonzero(car.mask), strict=True))
    assert car.mask.sum() == 12


def test_several_polygons_are_one_object():
    parts = [[10, 20, 14, 20, 14, 23, 10, 23], [12, 20, 18, 20, 18, 23, 12, 23]]
    (car,) = only(entry(bbox=[10, 20, 8, 3], segmentation=parts), masks=True)
    assert car.mask.sum() == 24


def star(rng, corners):
    angle = np.sort(rng.uniform(0, math.tau, corners))
    radius = rng.uniform(30, 150) * rng.uniform(0.3, 1, corners)
    return np.column_stack([320 + radius * np.cos(angle), 240 + radius * np.sin(angle)])


def draw(points):
    polygon = entry(bbox=[160, 80, 320, 320], segmentation=[points.ravel().tolist()])
    return only(polygon, masks=True)[0].mask


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), corners=st.integers(5, 40))
def test_a_mask_is_the_pixels_whose_centres_scikit_image_finds_in_the_polygon(seed, corners):
    points = star(np.random.default_rng(seed), corners)
    rows, columns = np.mgrid[:480, :640] + 0.5
    centres = np.column_stack([columns.ravel(), rows.ravel()])
    inside = ski.measure.points_in_poly(centres, points).reshape(480, 640)
    np.testing.assert_array_equal(draw(points), inside)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_polygons_are_drawn_as_pycocotools_draws_them_but_for_its_fifths_of_a_pixel():
    tools = pytest.importorskip("pycocotools.mask")
    rng = np.random.default_rng(5)
    for _ in range(100):
        points = star(rng, 12)
        outline = np.hypot(*np.diff(points, axis=0, append=points[:1]).T).sum()
        codes = tools.frPyObjects([points.ravel().tolist()], 480, 640)
        theirs = tools.decode(tools.merge(codes)) == 1
        # It moves corners to fifths of a pixel: at most 0.1 px per pixel of the outline, and
        # where it rounds the outline itself as much again.
        assert (theirs ^ draw(points)).sum() < 0.2 * outline


def test_run_lengths_go_down_the_columns_and_begin_with_what_is_off():
    lengths = {"size": [3, 4], "counts": [4, 2, 6]}
    (car,) = only(entry(bbox=[0, 0, 4, 3], segmentation=lengths), masks=True, width=4, height=3)
    np.testing.assert_array_equal(np.nonzero(car.mask), [[1, 2], [1, 1]])


@pytest.mark.parametrize("counts", [COMPRESSED["counts"], COMPRESSED["counts"].encode()])
def test_compressed_run_lengths_are_unrolled(counts):
    expected = np.zeros((7, 9), dtype=np.bool_)
    expected[2:5, 3:7] = True
    expected[6, 8] = True
    (car,) = only(
        entry(bbox=[0, 0, 9, 7], segmentation=COMPRESSED | {"counts": counts}),
        masks=True,
        width=9,
        height=7,
    )
    np.testing.assert_array_equal(car.mask, expected)


def test_pycocotools_run_lengths_give_its_masks_back():
    tools = pytest.importorskip("pycocotools.mask")
    rng = np.random.default_rng(3)
    for _ in range(200):
        height, width = (int(n) for n in rng.integers(1, 70, 2))
        mask = rng.random((height, width)) < rng.random() ** 3
        mask[0, 0] = True
        code = tools.encode(np.asfortranarray(mask.astype(np.uint8)))
        shape = {"width": width, "height": height}
        whole = entry(bbox=[0, 0, width, height], segmentation=code)
        np.testing.assert_array_equal(only(whole, masks=True, **shape)[0].mask, mask)


def test_the_mask_of_another_place_leaves_the_box_alone():
    polygon = entry(bbox=[10, 20, 30, 40], segmentation=[[300, 300, 320, 300, 320, 320]])
    assert only(polygon, masks=True)[0].mask is None


@pytest.mark.parametrize(
    "segmentation",
    [
        pytest.param([], id="no polygons"),
        pytest.param(None, id="null"),
        pytest.param([[10.6, 20.6, 10.9, 20.6, 10.9, 20.9]], id="no pixel's centre"),
        pytest.param({"size": [480, 640], "counts": [480 * 640]}, id="nothing on"),
    ],
)
def test_a_segmentation_without_a_pixel_is_no_mask(segmentation):
    assert only(entry(segmentation=segmentation), masks=True)[0].mask is None


@pytest.mark.parametrize(
    ("segmentation", "message"),
    [
        ([[1, 2, 3, 4]], r"three finite corners"),
        ([[1, 2, 3, 4, 5, 6, 7]], r"three finite corners"),
        ([1, 2, 3, 4, 5, 6], r"three finite corners or more; got shape \(\)"),
        ([[1, 2, 3, 4, 5, math.nan]], r"three finite corners"),
        ([[1, 2, [3], 4, 5, 6]], r"three finite corners"),
        ([["1", 2, 3, 4, 5, 6]], r"three finite corners"),
        ("g034", r"must be a list; got 'g034'"),
        ({"size": [480, 640]}, r"`counts` must be there; got `size`"),
        ({"size": [640, 480], "counts": [640 * 480]}, r"\[480, 640\]; got \[640, 480\]"),
        ({"size": [480, 640], "counts": [1, 2, 3]}, r"sum to height x width, 480 x 640"),
        ({"size": [480, 640], "counts": [-1, 480 * 640 + 1]}, r"sum to height x width"),
        ({"size": [480, 640], "counts": [480 * 640.0]}, r"sum to height x width"),
        ({"size": [480, 640], "counts": 3}, r"`counts` must be a list; got 3"),
        ({"size": [480, 640], "counts": "g0 1"}, r"from '0' to 'o'; got ' '"),
        ({"size": [480, 640], "counts": "g"}, r"cut off"),
        ({"size": [480, 640], "counts": "1"}, r"sum to height x width"),
    ],
)
def test_a_broken_segmentation_is_named_with_its_entry(segmentation, message):
    with pytest.raises((TypeError, ValueError), match=r"^annotations\[1\]: .*" + message):
        only(entry(), entry(segmentation=segmentation), masks=True)


@pytest.mark.parametrize(
    "segmentation",
    [
        pytest.param([[1, 2, 3, 4, 5, 6]], id="polygon"),
        pytest.param({"size": [3, 4], "counts": [4, 2, 6]}, id="run lengths"),
        pytest.param({"size": [1e6, 1e6], "counts": [10**12]}, id="a terabyte"),
        pytest.param({"size": [10**400, 1], "counts": [10**400]}, id="no size at all"),
    ],
)
def test_masks_without_a_picture_to_draw_in_are_refused(segmentation):
    with pytest.raises(ValueError, match=r"^annotations\[0\]: .*`width` and `height`"):
        only(entry(segmentation=segmentation), masks=True, height=None)


def test_annotations_without_an_area_are_left_out_by_the_line_of_the_message():
    # of COCO's own instances_train2017.json
    flat = entry(bbox=[296.65, 388.33, 1.03, 0.0])
    with pytest.raises(ValueError, match=r"positive width and height") as caught:
        only(entry(), flat)
    [remedy] = re.findall(r"out: (\[.*\])\.$", str(caught.value))
    kept = eval(remedy, {"entries": [entry(), flat]})  # noqa: S307 - our own words
    assert kept == [entry()]
    assert remedy.replace("entries", 'dataset["annotations"]') in from_coco.__doc__


# --- what is refused ---


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"bbox": [10, 20, 0, 50]}, r"positive width and height; got \[10.0, 20.0, 0.0, 50.0\]"),
        ({"bbox": [10, 20, 30, math.nan]}, r"positive width and height"),
        ({"bbox": [math.inf, 20, 30, 40]}, r"must be finite"),
        ({"bbox": [10, 20, 30]}, r"four numbers"),
        ({"bbox": None}, r"four numbers"),
        ({"bbox": {"x": 1}}, r"four numbers"),
        ({"bbox": ["10", "20", "30", "40"]}, r"four numbers"),
        ({"bbox": [700, 20, 100, 50]}, r"overlap the picture"),
        ({"category_id": 2}, r"`category_id` must be an id of `categories`; got 2"),
        ({"image_id": "7"}, r"`image_id` must be an id of `images`; got '7'"),
        ({"image_id": [7]}, r"`image_id` must be a whole number or a string; got list"),
        ({"image_id": True}, r"`image_id` must be a whole number or a string; got True"),
        ({"score": 90.0}, r"`score` must be between 0 and 1; got 90.0"),
        ({"score": "high"}, r"`score` must be between 0 and 1; got 'high'"),
    ],
)
def test_a_broken_entry_is_named_by_its_index(broken, message):
    with pytest.raises((TypeError, ValueError), match=r"^annotations\[1\]: .*" + message):
        only(entry(), entry(**broken))
    with pytest.raises((TypeError, ValueError), match=r"^results\[2\]: .*" + message):
        from_coco(dataset(), [entry(), entry(), entry(**broken)])


def test_corners_given_as_a_box_are_refused_where_the_picture_tells():
    with pytest.raises(ValueError, match=r"write \[x1, y1, x2 - x1, y2 - y1\]"):
        only(entry(bbox=[400, 300, 600, 450]))
    with pytest.raises(ValueError, match=r"fits as corners"):
        only(entry(bbox=[100, 300, 200, 450]))


def test_a_box_far_beyond_the_border_that_cannot_be_corners_is_cut():
    assert only(entry(bbox=[500, 20, 300, 50]))[0].xyxy == (500, 20, 640, 70)


@pytest.mark.parametrize("name", ["bbox", "image_id", "category_id"])
def test_a_missing_member_is_named_with_those_present(name):
    broken = entry()
    del broken[name]
    with pytest.raises(ValueError, match=rf"^annotations\[0\]: `{name}` must be there; got `"):
        only(broken)


@pytest.mark.parametrize("name", ["images", "categories", "annotations"])
def test_a_missing_part_of_the_dataset_is_named(name):
    broken = dataset(entry())
    del broken[name]
    with pytest.raises(ValueError, match=f"`{name}` must be there"):
        from_coco(broken)
    with pytest.raises(TypeError, match=f"`{name}` must be a list; got dict"):
        from_coco(dataset(entry()) | {name: {}})


@pytest.mark.parametrize(
    ("part", "double"),
    [
        ("images", {"id": 7, "file_name": "other.jpg"}),
        ("images", {"id": 8, "file_name": "street.jpg"}),
        ("categories", {"id": 3, "name": "van"}),
    ],
)
def test_two_of_one_name_are_refused(part, double):
    broken = dataset(entry())
    broken[part].append(double)
    with pytest.raises(ValueError, match=rf"^{part}\[[12]\]: .* came before"):
        from_coco(broken)


def test_a_picture_of_a_size_that_is_none_is_named():
    with pytest.raises(ValueError, match=r"^images\[0\]: .*two positive whole numbers"):
        only(width="640")


def test_a_category_without_a_name_is_named_where_it_is_used():
    broken = dataset(entry())
    broken["categories"][1]["name"] = None
    with pytest.raises(TypeError, match=r"^annotations\[0\]: `label` must be a string; got None"):
        from_coco(broken)


def test_results_in_the_place_of_the_dataset_are_sent_to_theirs():
    with pytest.raises(TypeError, match="Results are the second argument"):
        from_coco([entry()])


@pytest.mark.parametrize("broken", [3, "text", None])
def test_an_entry_that_is_no_object_is_named(broken):
    with pytest.raises(TypeError, match=r"^annotations\[0\]: `entry` must be a mapping"):
        only(broken)


# --- files ---


@pytest.mark.parametrize("content", [b"{", b"\xff\xfe\xff", b"", b"[" * 100_000])
def test_a_file_that_is_not_json_is_named(tmp_path, content):
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"broken\.json must hold JSON; got"):
        read_coco(path)


def test_errors_of_a_file_name_it(tmp_path):
    path = write_json(tmp_path, "truth.json", dataset(entry(category_id=5)))
    with pytest.raises(ValueError, match=r"truth\.json: annotations\[0\]: `category_id`"):
        read_coco(path)
    results = write_json(tmp_path, "seen.json", [entry(category_id=6)])
    with pytest.raises(ValueError, match=r"seen\.json on .*truth\.json: results\[0\]: "):
        read_coco(path, results)


def test_a_results_file_that_is_no_list_is_named(tmp_path):
    path = write_json(tmp_path, "truth.json", dataset(entry()))
    with pytest.raises(ValueError, match=r"seen\.json: `results` must be a list; got NoneType"):
        read_coco(path, write_json(tmp_path, "seen.json", None))


def test_a_files_masks_are_read_on_request(tmp_path):
    path = write_json(
        tmp_path, "truth.json", dataset(entry(segmentation=[[10, 20, 30, 20, 30, 40]]))
    )
    assert read_coco(path, masks=True)["street.jpg"][0].mask.shape == (480, 640)
