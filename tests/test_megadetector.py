"""MegaDetector's results: boxes, names, sizes of pictures, and what is not a picture at all."""

import copy
import json

import numpy as np
import pytest
from PIL import Image, ImageOps

from imgscale import PriorTable
from imgscale.detectors.coco import from_coco
from imgscale.detectors.megadetector import from_megadetector, read_megadetector

# The example of the format's description, version 1.6, without its comments.
DESCRIBED = {
    "info": {"format_version": "1.6", "detector": "MDV5A"},
    "detection_categories": {"1": "animal", "2": "person", "3": "vehicle"},
    "classification_categories": {"0": "fox", "1": "elk", "2": "wolf", "3": "bear", "4": "moose"},
    "images": [
        {
            "file": "path/from/base/dir/image_with_animal.jpg",
            "detections": [
                {
                    "category": "1",
                    "conf": 0.926,
                    "bbox": [0.0, 0.2762, 0.1539, 0.2825],
                    "classifications": [["3", 0.901], ["1", 0.071], ["4", 0.025]],
                },
                {"category": "1", "conf": 0.061, "bbox": [0.0451, 0.1849, 0.3642, 0.4636]},
            ],
        },
        {"file": "/path/from/base/dir/empty_image.jpg", "detections": []},
        {"file": "/path/from/base/dir/another_image.jpg", "detections": [], "failure": None},
        {
            "file": "/path/from/base/dir2/corrupted_image_0.jpg",
            "failure": "Failure image access",
            "detections": None,
        },
    ],
}
WITH_ANIMAL = "path/from/base/dir/image_with_animal.jpg"
SIZES = {WITH_ANIMAL: (2000, 1000)}


def results(*detections, **image):
    told = {"file": "a.jpg", "width": 2000, "height": 1000, "detections": list(detections)}
    return DESCRIBED | {"images": [told | image]}


def seen(**members):
    return {"category": "1", "conf": 0.5, "bbox": [0.25, 0.5, 0.125, 0.25]} | members


def only(*detections, **image):
    (found,) = from_megadetector(results(*detections, **image)).values()
    return found


def write_json(folder, content):
    path = folder / "results.json"
    path.write_text(json.dumps(content))
    return path


def save_picture(path, *, size=(64, 48), orientation=1, mode="RGB"):
    exif = Image.Exif()
    exif[0x0112] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size).save(path, exif=exif)


# --- boxes and names ---


def test_the_formats_own_example_is_read():
    found = from_megadetector(DESCRIBED, image_sizes=SIZES)
    bear, other = found[WITH_ANIMAL]
    assert (bear.label, bear.aliases, bear.score) == ("bear", ("animal",), 0.926)
    assert bear.xyxy == pytest.approx((0, 276.2, 307.8, 558.7))
    assert (other.label, other.aliases, other.score) == ("animal", (), 0.061)
    assert other.xyxy == pytest.approx((90.2, 184.9, 818.6, 648.5))


def test_pictures_that_nobody_could_look_at_are_not_among_those_without_animals():
    found = from_megadetector(DESCRIBED, image_sizes=SIZES)
    assert list(found) == [image["file"] for image in DESCRIBED["images"][:3]]
    assert [len(detections) for detections in found.values()] == [2, 0, 0]


def test_a_failure_is_left_out_whether_its_detections_are_null_empty_or_absent():
    broken = results(failure="Failure inference")
    for detections in (None, []):
        broken["images"][0]["detections"] = detections
        assert from_megadetector(broken) == {}
    del broken["images"][0]["detections"]
    assert from_megadetector(broken) == {}


def test_the_most_probable_class_is_the_label_in_whatever_order():
    (one,) = only(seen(classifications=[["1", 0.2], ["0", 0.7], ["4", 0.1]]))
    assert (one.label, one.aliases) == ("fox", ("animal",))


def test_people_and_vehicles_are_not_what_a_classifier_of_animals_says():
    for number, name in (("2", "person"), ("3", "vehicle")):
        (one,) = only(seen(category=number, classifications=[["1", 0.9]]))
        assert (one.label, one.aliases) == (name, ())


def test_the_shipped_priors_know_a_classified_animal_and_not_an_animal():
    table = PriorTable.default()
    fox, animal, person = only(
        seen(classifications=[["0", 0.9]]), seen(classifications=[]), seen(category="2")
    )
    assert fox.label in table
    assert person.label in table
    assert not any(name in table for name in animal.names)


def test_numbers_serve_as_ids_where_a_tool_wrote_no_strings():
    (one,) = only(seen(category=1, classifications=[[0, 0.9]]))
    assert one.label == "fox"


def test_a_box_a_little_beyond_the_border_is_cut():
    (one,) = only(seen(bbox=[-0.01, 0.9, 0.5, 0.12]))
    assert one.xyxy == pytest.approx((0, 900, 980, 1000))


def test_the_input_is_not_written_to():
    before = copy.deepcopy(DESCRIBED)
    from_megadetector(DESCRIBED, image_sizes=SIZES)
    assert before == DESCRIBED


def test_boxes_are_those_of_megadetectors_own_way_to_coco(tmp_path):
    tools = pytest.importorskip("megadetector.postprocessing.md_to_coco")
    rng = np.random.default_rng(1)
    boxes = np.round(rng.uniform(0.01, 0.5, (20, 4)), 4).tolist()
    path = write_json(tmp_path, results(*[seen(bbox=box) for box in boxes]))
    coco = tools.md_to_coco(str(path), str(tmp_path / "coco.json"), verbose=False)
    ours, theirs = read_megadetector(path)["a.jpg"], from_coco(coco)["a.jpg"]
    np.testing.assert_allclose([d.xyxy for d in ours], [d.xyxy for d in theirs], atol=1e-9)
    assert [d.label for d in ours] == [d.label for d in theirs]


# --- sizes of pictures ---


def test_a_size_in_the_results_needs_no_other():
    assert only(seen())[0].xyxy == (500, 500, 750, 750)


def test_a_given_size_must_be_the_one_in_the_results():
    assert from_megadetector(results(seen()), image_sizes={"a.jpg": (2000, 1000)})
    with pytest.raises(ValueError, match=r"^images\[0\]: .*got \(1000, 2000\) for 'a.jpg'"):
        from_megadetector(results(seen()), image_sizes={"a.jpg": (1000, 2000)})


def test_sizes_go_by_the_file():
    with pytest.raises(TypeError, match=r"`image_sizes` must be a mapping .*; got tuple"):
        from_megadetector(results(seen()), image_sizes=(2000, 1000))


def test_an_unknown_size_is_an_error_only_where_there_is_something_to_place():
    unknown = results(width=None)
    assert from_megadetector(unknown) == {"a.jpg": []}
    with pytest.raises(ValueError, match=r"^images\[0\]: the size of 'a.jpg' must be known"):
        from_megadetector(results(seen(), width=None), image_sizes={"b.jpg": (10, 10)})


@pytest.mark.parametrize(
    ("orientation", "size"),
    [(0, (64, 48)), (1, (64, 48)), (3, (64, 48)), (6, (48, 64)), (8, (48, 64))],
)
def test_sizes_are_read_from_pictures_as_they_stand_upright(tmp_path, orientation, size):
    save_picture(tmp_path / "site 1" / "a.jpg", orientation=orientation)
    path = write_json(tmp_path, results(seen(), file="site 1/a.jpg", width=None))
    (found,) = read_megadetector(path, image_folder=tmp_path)["site 1/a.jpg"]
    width, height = size
    assert found.xyxy == (0.25 * width, 0.5 * height, 0.375 * width, 0.75 * height)
    with Image.open(tmp_path / "site 1" / "a.jpg") as picture:
        assert ImageOps.exif_transpose(picture).size == size


@pytest.mark.parametrize(("orientation", "mode"), [(2, "RGB"), (5, "RGB"), (7, "RGB"), (6, "L")])
def test_pictures_that_megadetector_does_not_turn_upright_are_refused(tmp_path, orientation, mode):
    save_picture(tmp_path / "a.jpg", orientation=orientation, mode=mode)
    path = write_json(tmp_path, results(seen(), width=None))
    with pytest.raises(ValueError, match=rf"results\.json: .*a\.jpg .*orientation {orientation}"):
        read_megadetector(path, image_folder=tmp_path)


@pytest.mark.parametrize("mode", ["RGB", "L"])
@pytest.mark.parametrize("orientation", range(9))
def test_megadetector_sees_a_picture_in_the_size_read_or_it_is_refused(tmp_path, orientation, mode):
    tools = pytest.importorskip("megadetector.visualization.visualization_utils")
    save_picture(tmp_path / "a.jpg", orientation=orientation, mode=mode)
    path = write_json(tmp_path, results(seen(bbox=[0, 0, 1, 1]), width=None))
    picture = tools.load_image(str(tmp_path / "a.jpg"))
    try:
        (found,) = read_megadetector(path, image_folder=tmp_path)["a.jpg"]
    except ValueError:
        assert orientation > 1
        assert picture.size == (64, 48)
    else:
        assert found.xyxy[2:] == picture.size


def test_windows_separators_find_their_picture(tmp_path):
    save_picture(tmp_path / "site" / "a.jpg")
    path = write_json(tmp_path, results(seen(), file="site\\a.jpg", width=None))
    assert len(read_megadetector(path, image_folder=tmp_path)["site/a.jpg"]) == 1


@pytest.mark.parametrize("told", ["site\\a.jpg", "site/a.jpg"])
@pytest.mark.parametrize("given", ["site\\a.jpg", "site/a.jpg"])
def test_files_are_named_with_forward_slashes_however_they_are_told(told, given):
    content = results(seen(), file=told, width=None)
    found = from_megadetector(content, image_sizes={given: (2000, 1000)})
    assert [(file, found[file][0].xyxy[0]) for file in found] == [("site/a.jpg", 500)]


def test_a_file_told_with_both_kinds_of_slash_came_twice():
    content = results(seen(), file="site\\a.jpg")
    content["images"] += results(seen(), file="site/a.jpg")["images"]
    with pytest.raises(ValueError, match=r"^images\[1\]: .*'site/a.jpg' came before"):
        from_megadetector(content)


def test_only_pictures_that_need_a_size_are_opened(tmp_path):
    content = results(seen())
    content["images"].append({"file": "absent.jpg", "detections": []})
    path = write_json(tmp_path, content)
    assert list(read_megadetector(path, image_folder=tmp_path)) == ["a.jpg", "absent.jpg"]


def test_a_picture_that_cannot_be_read_is_named(tmp_path):
    path = write_json(tmp_path, results(seen(), width=None))
    with pytest.raises(ValueError, match=r"images\[0\]: .*a\.jpg must be a picture"):
        read_megadetector(path, image_folder=tmp_path)
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"images\[0\]: .*a\.jpg must be a picture"):
        read_megadetector(path, image_folder=tmp_path)


# --- what is refused ---


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"category": "7"}, r"must be one of `detection_categories`; got '7'"),
        ({"classifications": [["9", 1]]}, r"must be one of `classification_categories`; got '9'"),
        ({"classifications": [["1"]]}, r"pairs of a class and a confidence; got \['1'\]"),
        ({"classifications": [["1", "much"]]}, r"pairs of a class and a confidence"),
        ({"classifications": "1"}, r"`classifications` must be a list; got '1'"),
        ({"bbox": [500, 500, 250, 250]}, r"ratios of the picture's size; got \[500.0"),
        ({"bbox": [0.5, 0.5, 0.75, 0.75]}, r"ratios of the picture's size"),
        ({"bbox": [0.5, 0.5, 0, 0.2]}, r"positive width and height"),
        ({"bbox": [0.5, 0.5, 0.1, -0.2]}, r"positive width and height"),
        ({"bbox": [0.5, float("nan"), 0.1, 0.2]}, r"ratios of the picture's size"),
        ({"bbox": [0.5, 0.5]}, r"four ratios"),
        ({"conf": 92.6}, r"`score` must be between 0 and 1; got 92.6"),
        ({"conf": None}, r"`score` must be between 0 and 1; got None"),
    ],
)
def test_a_broken_detection_is_named_by_its_place(broken, message):
    with pytest.raises(
        (TypeError, ValueError), match=r"^images\[0\]: detections\[1\]: .*" + message
    ):
        only(seen(), seen(**broken))


@pytest.mark.parametrize("name", ["category", "conf", "bbox"])
def test_a_missing_member_is_named(name):
    broken = seen()
    del broken[name]
    with pytest.raises(ValueError, match=rf"^images\[0\]: detections\[0\]: `{name}` must be there"):
        only(broken)


@pytest.mark.parametrize("name", ["detection_categories", "images"])
def test_a_missing_part_of_the_results_is_named(name):
    with pytest.raises(ValueError, match=f"`{name}` must be there"):
        from_megadetector({key: value for key, value in DESCRIBED.items() if key != name})
    with pytest.raises(TypeError, match=f"`{name}` must be a (mapping|list).*; got 3"):
        from_megadetector(DESCRIBED | {name: 3})


def test_no_detections_and_no_failure_is_neither_looked_at_nor_failed():
    broken = results()
    del broken["images"][0]["detections"]
    with pytest.raises(ValueError, match=r"^images\[0\]: `detections` must be there"):
        from_megadetector(broken)
    with pytest.raises(TypeError, match=r"^images\[0\]: `detections` must be a list"):
        from_megadetector(results() | {"images": [{"file": "a.jpg", "detections": None}]})


def test_frames_of_a_video_are_not_mixed_into_one_picture():
    film = {"frame_rate": 20, "frames_processed": [0, 20]}
    with pytest.raises(ValueError, match=r"^images\[0\]: .*must be a picture; got a video"):
        only(seen(frame_number=0), seen(frame_number=20), **film)


def test_a_file_that_comes_twice_is_refused():
    content = results(seen())
    content["images"] *= 2
    with pytest.raises(ValueError, match=r"^images\[1\]: .*'a.jpg' came before"):
        from_megadetector(content)


def test_a_flat_list_in_pixels_is_another_format():
    flat = [{"file": "a.jpg", "detections": [{"category": "animal", "bbox": [1, 2, 3, 4]}]}]
    with pytest.raises(TypeError, match="Boxes of a flat list in pixels"):
        from_megadetector(flat)


def test_errors_of_a_file_name_it(tmp_path):
    with pytest.raises(ValueError, match=r"results\.json: images\[0\]: detections\[0\]: "):
        read_megadetector(write_json(tmp_path, results(seen(category="7"))))
    (tmp_path / "results.json").write_text("{'images': []}")
    with pytest.raises(ValueError, match=r"results\.json must hold JSON"):
        read_megadetector(tmp_path / "results.json")
