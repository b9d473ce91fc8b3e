"""Priors and their table: look-up, mixtures, regions, the paper's table, CSV and refusals."""

import copy
import math
import pickle
import re
import threading

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats

from imgscale import ObjectPrior, PriorTable
from imgscale.object_prior import normal_label

HEADER = "label,mean_m,std_m"


def write(path, text, encoding="utf-8"):
    path.write_text(text, encoding=encoding)
    return path


# --- one prior ---


def test_prior_keeps_its_numbers_and_defaults():
    prior = ObjectPrior("survey pole", 1.0, 0.002)
    assert (prior.label, prior.mean_m, prior.std_m, prior.mean_std_m) == (
        "survey pole",
        1.0,
        0.002,
        0.0,
    )
    assert (prior.axis, prior.on_ground, prior.depth_extent_m) == ("height", True, None)
    assert (prior.share, prior.aliases, prior.source) == (1.0, (), "")
    assert (prior.region, prior.year, prior.n) == ("world", None, None)


def test_only_label_mean_and_spread_may_be_given_by_position():
    with pytest.raises(TypeError, match="positional"):
        ObjectPrior("survey pole", 1.0, 0.002, 0.001)


@pytest.mark.parametrize("number", [int, np.float32, np.float64, np.int64])
def test_numpy_numbers_become_python_floats(number):
    prior = ObjectPrior(
        "pole",
        number(2),
        number(0),
        mean_std_m=number(1),
        depth_extent_m=number(3),
        share=number(1),
    )
    numbers = (prior.mean_m, prior.std_m, prior.mean_std_m, prior.depth_extent_m, prior.share)
    assert numbers == (2.0, 0.0, 1.0, 3.0, 1.0)
    assert {type(value) for value in numbers} == {float}


def test_equal_priors_are_equal_hash_alike_and_pickle():
    one, other = (ObjectPrior("pole", 1.0, 0.1, aliases=["rod"]) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != ObjectPrior("pole", 1.0, 0.1)
    assert pickle.loads(pickle.dumps(one)) == one  # noqa: S301 - our own bytes


def test_prior_cannot_be_set():
    prior = ObjectPrior("pole", 1.0, 0.1)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        prior.mean_m = 2.0


def test_later_edits_of_the_callers_aliases_do_not_show():
    aliases = ["rod"]
    prior = ObjectPrior("pole", 1.0, 0.1, aliases=aliases)
    aliases.append("staff")
    assert prior.aliases == ("rod",)


def test_one_alias_given_as_text_is_one_alias_not_its_letters():
    assert ObjectPrior("pole", 1.0, 0.1, aliases="rod").aliases == ("rod",)


def test_names_are_the_label_and_its_aliases_as_compared_each_once():
    prior = ObjectPrior("Survey_Pole", 1.0, 0.1, aliases=("survey-pole", "ROD"))
    assert prior.names == ("survey pole", "rod")


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", ["mean_m", "depth_extent_m"])
def test_length_that_is_not_positive_is_refused(name, value):
    options = {"label": "pole", "mean_m": 1.0, "std_m": 0.1, name: value}
    with pytest.raises(ValueError, match=f"`{name}` must be finite and positive; got {value}"):
        ObjectPrior(**options)


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
@pytest.mark.parametrize("name", ["std_m", "mean_std_m"])
def test_unlawful_spread_is_refused(name, value):
    options = {"label": "pole", "mean_m": 1.0, "std_m": 0.1, name: value}
    with pytest.raises(ValueError, match=f"`{name}` must be finite and not negative; got {value}"):
        ObjectPrior(**options)


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, 50.0, math.nan])
def test_unlawful_share_is_refused(share):
    with pytest.raises(ValueError, match=f"`share` must be above 0 and at most 1; got {share}"):
        ObjectPrior("pole", 1.0, 0.1, share=share)


@pytest.mark.parametrize("value", ["1.0", True, None, [1.0]])
@pytest.mark.parametrize("name", ["mean_m", "std_m", "mean_std_m", "share"])
def test_number_that_is_none_is_a_type_error_naming_it(name, value):
    options = {"label": "pole", "mean_m": 1.0, "std_m": 0.1, name: value}
    law = rf"`{name}` must be .*; got {re.escape(repr(value))}"
    with pytest.raises(TypeError, match=law):
        ObjectPrior(**options)


@pytest.mark.parametrize("axis", ["length", "Height", "", None, 0])
def test_unknown_axis_is_refused_with_the_choices(axis):
    law = f'`axis` must be one of "height", "width", "diameter"; got {axis!r}'
    with pytest.raises(ValueError, match=re.escape(law)):
        ObjectPrior("pole", 1.0, 0.1, axis=axis)


@pytest.mark.parametrize("region", ["EU", "asia", None])
def test_unknown_region_is_refused_with_the_choices(region, tmp_path):
    law = re.escape(f'`region` must be one of "world", "eu", "us"; got {region!r}')
    file = write(tmp_path / "a.csv", f"{HEADER}\npole,1,0.1\n")
    with pytest.raises(ValueError, match=law):
        ObjectPrior("pole", 1.0, 0.1, region=region)
    with pytest.raises(ValueError, match=law):
        PriorTable.default(region)
    with pytest.raises(ValueError, match=law):
        PriorTable.from_csv(file, region=region)


@pytest.mark.parametrize("label", [None, 3])
def test_label_that_is_no_string_is_a_type_error(label):
    with pytest.raises(TypeError, match=f"`label` must be a string; got {label}"):
        ObjectPrior(label, 1.0, 0.1)


def test_blank_label_is_refused():
    with pytest.raises(ValueError, match="`label` must not be blank; got '  '"):
        ObjectPrior("  ", 1.0, 0.1)


@pytest.mark.parametrize("aliases", [(3,), ("rod", None)])
def test_aliases_that_are_no_strings_are_a_type_error_naming_them(aliases):
    with pytest.raises(TypeError, match="`aliases` must"):
        ObjectPrior("pole", 1.0, 0.1, aliases=aliases)


def test_on_ground_given_as_a_word_is_refused_not_taken_as_true():
    with pytest.raises((TypeError, ValueError), match="`on_ground` must be"):
        ObjectPrior("lamp", 1.0, 0.1, on_ground="false")


# --- units ---


@pytest.mark.parametrize(
    ("label", "mean"),
    [
        pytest.param("car", 151.0, id="car in centimetres"),
        pytest.param("car", 1510.0, id="car in millimetres"),
        pytest.param("Car", 60.0, id="car in inches"),
        pytest.param("person", 172.0, id="person in centimetres"),
        pytest.param("HUMAN", 1720.0, id="alias in millimetres"),
        pytest.param("traffic_light", 0.01, id="metres taken for centimetres"),
        pytest.param("door", 0.00203, id="metres taken for millimetres"),
    ],
)
def test_mean_in_another_unit_is_refused_naming_metres_and_the_shipped_rows(label, mean):
    law = rf'`mean_m` of "{label}" must be in metres; got {mean}, where the shipped rows say \d'
    with pytest.raises(ValueError, match=law) as caught:
        ObjectPrior(label, mean, 0.1)
    assert "Divide centimetres by 100" in str(caught.value)


def test_coin_diameter_in_millimetres_is_refused_on_its_own_axis():
    with pytest.raises(ValueError, match=r'of "1 euro coin" must be in metres; got 23\.25'):
        ObjectPrior("1 euro coin", 23.25, 0.0, axis="diameter")
    assert ObjectPrior("1 euro coin", 0.02325, 0.0, axis="diameter").mean_m == 0.02325


def test_mean_may_be_five_times_off_the_shipped_row_but_not_more():
    (shipped,) = PriorTable.default().lookup("fire hydrant")
    for factor in (4.999, 1 / 4.999):
        assert ObjectPrior("fire hydrant", factor * shipped.mean_m, 0.1)
    for factor in (5.001, 1 / 5.001):
        with pytest.raises(ValueError, match="must be in metres"):
            ObjectPrior("fire hydrant", factor * shipped.mean_m, 0.1)


def test_several_shipped_rows_are_named_as_a_range():
    with pytest.raises(ValueError, match=r"the shipped rows say 1\.53 to 1\.735\."):
        ObjectPrior("car", 151.0, 12.0)


@pytest.mark.parametrize(
    ("label", "axis"),
    [pytest.param("zeppelin", "height", id="label"), pytest.param("car", "diameter", id="axis")],
)
def test_what_the_shipped_table_does_not_know_may_have_any_size(label, axis):
    assert ObjectPrior(label, 245.0, 1.0, axis=axis).mean_m == 245.0


# --- look-up ---


@pytest.mark.parametrize(
    ("label", "normal"),
    [
        ("Traffic Light", "traffic light"),
        ("traffic_light", "traffic light"),
        ("TRAFFIC-LIGHT", "traffic light"),
        ("  traffic \t light ", "traffic light"),
        ("traffic__light", "traffic light"),
        ("STRASSE", "strasse"),
        ("Straße", "strasse"),
    ],
)
def test_labels_are_compared_after_casefold_and_with_spaces(label, normal):
    assert normal_label(label) == normal


@given(label=st.text())
def test_normal_label_is_its_own_normal_form(label):
    assert normal_label(normal_label(label)) == normal_label(label)


@pytest.mark.parametrize("label", ["survey pole", "Survey_Pole", "SURVEY-POLE", "rod", "Red_Rod"])
def test_table_finds_a_row_by_label_or_alias_however_spelt(label):
    prior = ObjectPrior("Survey-pole", 1.0, 0.002, aliases=("rod", "red rod"))
    table = PriorTable([prior])
    assert table.lookup(label) == (prior,)
    assert label in table


@pytest.mark.parametrize("label", ["pole", "survey", "survey poles", "surveypole", ""])
def test_table_matches_exactly_and_says_nothing_of_others(label):
    table = PriorTable([ObjectPrior("survey pole", 1.0, 0.002)])
    assert table.lookup(label) == ()
    assert label not in table


def test_what_is_no_string_is_not_in_the_table():
    table = PriorTable([ObjectPrior("1", 1.0, 0.1)])
    assert 1 not in table
    assert None not in table


def test_rows_of_one_label_are_a_mixture_found_in_their_order():
    small = ObjectPrior("van", 1.9, 0.1, share=0.6)
    large = ObjectPrior("Van", 2.6, 0.3, share=0.4, aliases=("lorry van",))
    other = ObjectPrior("pole", 1.0, 0.1)
    table = PriorTable([small, other, large])
    assert table.lookup("van") == (small, large)
    assert table.lookup("lorry van") == (small, large)


def test_rows_of_every_axis_are_found():
    rows = [
        ObjectPrior("id card", 0.054, 0.0),
        ObjectPrior("id card", 0.0856, 0.0, axis="width"),
    ]
    assert [row.axis for row in PriorTable(rows).lookup("ID_Card")] == ["height", "width"]


def test_table_is_a_collection_of_its_rows():
    rows = [ObjectPrior("van", 1.9, 0.1), ObjectPrior("van", 2.6, 0.3), ObjectPrior("rod", 1, 0)]
    table = PriorTable(iter(rows))
    assert len(table) == 3
    assert list(table) == rows
    assert table.priors == tuple(rows)
    assert table.labels == ("van", "rod")


def test_empty_table_is_lawful():
    table = PriorTable([])
    assert len(table) == 0
    assert "car" not in table


def test_tables_of_the_same_rows_are_equal_hash_alike_and_pickle():
    one, other = (PriorTable([ObjectPrior("rod", 1.0, 0.1)]) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != PriorTable([])
    clone = pickle.loads(pickle.dumps(one))  # noqa: S301 - our own bytes
    assert clone == one
    assert clone.lookup("rod") == one.lookup("rod")


def test_table_cannot_be_set():
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        PriorTable([]).priors = ()


@pytest.mark.parametrize(
    "rows",
    [
        pytest.param(
            (
                ObjectPrior("rod", 1, 0, aliases=("pole",)),
                ObjectPrior("mast", 9, 1, aliases="Pole"),
            ),
            id="alias twice",
        ),
        pytest.param(
            (ObjectPrior("rod", 1, 0, aliases=("pole",)), ObjectPrior("Pole", 9, 1)),
            id="alias, then label",
        ),
        pytest.param(
            (ObjectPrior("pole", 9, 1), ObjectPrior("rod", 1, 0, aliases=("POLE",))),
            id="label, then alias",
        ),
    ],
)
def test_name_of_two_labels_is_refused_naming_both(rows):
    first, second = (normal_label(row.label) for row in rows)
    law = f'`priors` must give each name to one label; got "pole" for "{first}" and for "{second}"'
    with pytest.raises(ValueError, match=re.escape(law)):
        PriorTable(rows)


def test_what_is_no_prior_is_refused_with_its_place():
    rows = [ObjectPrior("rod", 1, 0), ("mast", 9.0, 1.0)]
    law = r"`priors` must hold ObjectPrior objects; got \('mast', 9\.0, 1\.0\) at index 1"
    with pytest.raises(TypeError, match=law):
        PriorTable(rows)


# --- all rows of a label together ---


def test_sizes_of_a_label_are_one_mixture_for_each_axis():
    small = ObjectPrior("van", 1.9, 0.1, mean_std_m=0.02, share=0.6)
    large = ObjectPrior("Van", 2.6, 0.3, mean_std_m=0.05, share=0.2, aliases=("lorry van",))
    long = ObjectPrior("van", 5.2, 0.4, axis="diameter")
    wide = ObjectPrior("van", 2.0, 0.1, axis="width")
    found = PriorTable([long, small, wide, large]).sizes("Lorry_VAN")
    assert list(found) == ["height", "width", "diameter"]
    high = found["height"]
    assert high.rows == (small, large)
    assert high.key == ("van", "height")
    share = np.array([0.75, 0.25])
    mean = float(np.average([1.9, 2.6], weights=share))
    second = float(np.average([0.1**2 + 1.9**2, 0.3**2 + 2.6**2], weights=share))
    assert high.mean_m == pytest.approx(mean, rel=1e-12)
    assert high.std_m == pytest.approx(math.sqrt(second - mean**2), rel=1e-12)
    assert high.mean_std_m == pytest.approx(0.0275, rel=1e-12)
    assert high.tau == pytest.approx(0.0275 / mean, rel=1e-12)
    assert [kind[0] for kind in high.kinds] == pytest.approx(share, rel=1e-12)
    assert (found["width"].rows, found["width"].std_m) == ((wide,), 0.1)


@pytest.mark.parametrize("label", PriorTable.default().labels)
def test_log_moments_are_those_of_the_log_normal_size_with_these_moments(label):
    for size in PriorTable.default().sizes(label).values():
        whole = (1.0, size.log_mean, size.log_var)
        told = [(size.mean_m, size.std_m), *((row.mean_m, row.std_m) for row in size.rows)]
        for (mean_m, std_m), (_, log_mean, log_var) in zip(told, (whole, *size.kinds), strict=True):
            scipys = stats.lognorm(math.sqrt(log_var) or 1e-12, scale=math.exp(log_mean))
            assert (scipys.mean(), scipys.std()) == pytest.approx((mean_m, std_m), abs=1e-9)


def test_sizes_of_what_the_table_does_not_know_are_none():
    table = PriorTable([ObjectPrior("rod", 1.0, 0.1)])
    assert dict(table.sizes("giraffe")) == {}
    assert "giraffe" not in table


def test_sizes_that_were_found_cannot_be_changed():
    table = PriorTable([ObjectPrior("rod", 1.0, 0.1)])
    with pytest.raises(TypeError, match="does not support item assignment"):
        table.sizes("rod")["height"] = None
    assert table.sizes("rod")["height"].mean_m == 1.0


@pytest.mark.parametrize(
    "clone",
    [copy.copy, copy.deepcopy, lambda table: pickle.loads(pickle.dumps(table))],  # noqa: S301 - our own bytes
    ids=["copy", "deepcopy", "pickle"],
)
def test_a_table_that_was_asked_is_the_table_that_was_not(clone):
    asked, fresh = (PriorTable([ObjectPrior("rod", 1.0, 0.1)]) for _ in range(2))
    before = asked.sizes("rod")
    assert len(pickle.dumps(asked)) == len(pickle.dumps(fresh))
    for other in (asked, clone(asked)):
        assert other == fresh
        assert hash(other) == hash(fresh)
        assert repr(other) == repr(fresh)
        assert other.sizes("rod") == before


def test_threads_that_ask_a_new_table_at_once_find_the_same():
    rows = PriorTable.default().priors
    table, told = PriorTable(rows), PriorTable(rows)
    labels = [prior.label for prior in rows]
    expected = [dict(told.sizes(label)) for label in labels]
    start, found = threading.Barrier(8), []

    def ask():
        start.wait()
        found.append([dict(table.sizes(label)) for label in labels])

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 8


# --- with_prior ---


def test_with_prior_adds_a_new_label_and_leaves_the_old_table_alone():
    table = PriorTable([ObjectPrior("rod", 1, 0)])
    larger = table.with_prior(ObjectPrior("mast", 9, 1))
    assert larger.labels == ("rod", "mast")
    assert "mast" not in table


def test_with_prior_replaces_all_rows_of_its_label_however_spelt():
    table = PriorTable(
        [
            ObjectPrior("van", 1.9, 0.1, share=0.6),
            ObjectPrior("van", 2.6, 0.3, share=0.4),
            ObjectPrior("van", 1.8, 0.1, axis="width"),
        ]
    )
    mine = ObjectPrior("VAN", 2.05, 0.01)
    assert table.with_prior(mine).priors == (mine,)


def test_with_prior_takes_an_alias_over_and_leaves_its_label():
    car = ObjectPrior("car", 1.6, 0.16, aliases=("automobile", "taxi"))
    mine = ObjectPrior("Taxi", 1.7, 0.02)
    table = PriorTable([car]).with_prior(mine)
    assert table.lookup("taxi") == (mine,)
    assert [row.mean_m for row in table.lookup("automobile")] == [1.6]
    assert table.lookup("car")[0].aliases == ("automobile",)


def test_with_prior_takes_over_what_its_own_aliases_name():
    rows = [
        ObjectPrior("car", 1.6, 0.16, aliases=("automobile",)),
        ObjectPrior("rod", 1, 0, aliases=("stick",)),
    ]
    mine = ObjectPrior("my thing", 1.2, 0.01, aliases=("Automobile",))
    table = PriorTable(rows).with_prior(mine)
    assert table.lookup("automobile") == (mine,)
    assert table.lookup("car")[0].mean_m == 1.6


def test_with_prior_does_not_drop_another_label_that_it_names_as_alias():
    rows = [ObjectPrior("rod", 1, 0, aliases=("stick",))]
    with pytest.raises(ValueError, match='"rod" for "rod" and for "my thing"'):
        PriorTable(rows).with_prior(ObjectPrior("my thing", 1.2, 0.01, aliases=("ROD",)))


def test_with_prior_twice_keeps_the_last():
    table = PriorTable.default()
    for height in (1.98, 2.031):
        table = table.with_prior(ObjectPrior("door", height, 0.002))
    assert [row.mean_m for row in table.lookup("door")] == [2.031]


def test_with_prior_can_name_every_alias_of_the_shipped_table():
    table = PriorTable.default()
    for name in ("automobile", "human", "sofa", "mobile phone"):
        assert name in table
        changed = table.with_prior(ObjectPrior(name, 1.0 if name != "mobile phone" else 0.15, 0.1))
        assert len(changed.lookup(name)) == 1


@pytest.mark.parametrize("prior", ["door", ("door", 2.0, 0.01), None])
def test_with_prior_refuses_what_is_no_prior(prior):
    with pytest.raises(TypeError, match="ObjectPrior"):
        PriorTable([]).with_prior(prior)


# --- the shipped tables ---


@pytest.mark.parametrize(
    ("region", "label", "axis", "mean_m"),
    [
        # facts: EU plates are 520 mm wide, US plates 12 in; US doors are 6 ft 8 in high
        pytest.param("eu", "licence plate", "width", 0.520, id="EU plate"),
        pytest.param("us", "license_plate", "width", 0.3048, id="US plate"),
        pytest.param("us", "door", "height", 2.032, id="US door"),
        pytest.param("world", "Credit Card", "diameter", 0.0856, id="ISO 7810, longer side"),
        pytest.param("eu", "A4 sheet", "diameter", 0.297, id="world row in eu"),
        pytest.param("us", "1 euro coin", "diameter", 0.02325, id="world row in us"),
        pytest.param("world", "standard gauge track", "width", 1.435, id="rails"),
    ],
)
def test_default_table_gives_the_regions_row_or_the_worlds(region, label, axis, mean_m):
    rows = [row for row in PriorTable.default(region).lookup(label) if row.axis == axis]
    assert [row.mean_m for row in rows] == [mean_m]


def test_default_is_the_world():
    assert PriorTable.default() == PriorTable.default("world")
    assert {row.region for row in PriorTable.default()} == {"world"}


@pytest.mark.parametrize("region", ["eu", "us"])
def test_regions_replace_rows_and_lose_no_label_or_name(region):
    world, own = PriorTable.default("world"), PriorTable.default(region)
    assert {row.region for row in own} == {"world", region}
    assert set(own.labels) == set(world.labels)
    for row in world:
        for name in row.names:
            assert {found.axis for found in own.lookup(name)} == {
                found.axis for found in world.lookup(name)
            }
    for label in own.labels:
        for axis in ("height", "width", "diameter"):
            assert len({row.region for row in own.lookup(label) if row.axis == axis}) <= 1


def test_cars_are_higher_in_the_us_than_in_the_world_than_in_the_eu():
    heights = [PriorTable.default(region).lookup("car")[0].mean_m for region in ("us", "eu")]
    world = PriorTable.default().lookup("car")[0].mean_m
    assert heights[0] > world > heights[1]


@pytest.mark.parametrize("label", ["person", "car", "truck", "bicycle", "bottle", "cell phone"])
def test_common_detector_labels_are_known(label):
    assert label in PriorTable.default()


def test_paper_table_is_table_3_2_and_nothing_else():
    table = PriorTable.paper()
    assert {row.label: row.mean_m for row in table} == {
        "train": 4.02,
        "car": 1.70,
        "person": 1.72,
        "traffic signal": 2.10,
        "truck": 2.80,
        "wheel": 0.83,
    }
    assert len(table) == 6
    assert {row.axis for row in table} == {"height"}
    assert {row.aliases for row in table} == {()}


def test_paper_table_finds_its_labels_as_the_paper_prints_them():
    table = PriorTable.paper()
    assert [row.mean_m for row in table.lookup("Traffic Signal")] == [2.10]
    assert "van" not in table


# --- CSV ---


@pytest.mark.parametrize("region", ["world", "eu", "us"])
def test_shipped_table_survives_a_csv_round_trip(tmp_path, region):
    table = PriorTable.default(region)
    table.to_csv(tmp_path / "priors.csv")
    assert PriorTable.from_csv(tmp_path / "priors.csv", region=region) == table


def test_paper_table_survives_a_csv_round_trip(tmp_path):
    PriorTable.paper().to_csv(tmp_path / "paper.csv")
    assert PriorTable.from_csv(tmp_path / "paper.csv") == PriorTable.paper()


def test_every_field_survives_a_csv_round_trip(tmp_path):
    table = PriorTable(
        [
            ObjectPrior(
                "Förster's pole, red",
                1 / 3,
                1e-7,
                mean_std_m=0.1 + 0.2,
                axis="width",
                on_ground=False,
                depth_extent_m=0.05,
                share=0.7,
                aliases=("rod", "長い棒"),
                source='said "so"; then\nsaid no, twice',
                year=2019,
                n=12,
                spans="end, to end",
            ),
            ObjectPrior("mast", 9, 1),
        ]
    )
    table.to_csv(str(tmp_path / "a.csv"))
    assert PriorTable.from_csv(str(tmp_path / "a.csv")) == table


NAMES = st.text(
    st.characters(codec="utf-8", categories=("L", "N", "P", "Zs")), min_size=1, max_size=12
).filter(lambda name: normal_label(name) == name and ";" not in name)


@settings(
    deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    names=st.lists(NAMES, min_size=1, max_size=6, unique=True),
    mean=st.floats(1e-3, 1e3),
    std=st.floats(0, 10),
    share=st.floats(1e-3, 1),
    on_ground=st.booleans(),
)
def test_any_table_survives_a_csv_round_trip(tmp_path, names, mean, std, share, on_ground):
    std = min(std, mean)
    options = {"share": share, "on_ground": on_ground, "axis": "width"}
    label = f"thing {names[0]}".strip()
    rows = [ObjectPrior(label, mean, std, aliases=names[1:], mean_std_m=std, **options)]
    table = PriorTable([*rows, ObjectPrior(label, mean, std, depth_extent_m=mean, year=1999)])
    table.to_csv(tmp_path / "a.csv")
    assert PriorTable.from_csv(tmp_path / "a.csv") == table


def test_an_alias_with_a_semicolon_is_refused_or_survives_a_csv_round_trip(tmp_path):
    try:
        table = PriorTable([ObjectPrior("rod", 1.0, 0.1, aliases=("stick; long",))])
        table.to_csv(tmp_path / "a.csv")
    except ValueError:
        return
    assert PriorTable.from_csv(tmp_path / "a.csv") == table


def test_only_three_columns_are_needed(tmp_path):
    file = write(tmp_path / "a.csv", f"{HEADER}\npole,1.0,0.1\n")
    assert PriorTable.from_csv(file) == PriorTable([ObjectPrior("pole", 1.0, 0.1)])


def test_empty_cells_take_the_defaults_and_cells_are_trimmed(tmp_path):
    text = (
        "label,aliases,axis,mean_m,std_m,mean_std_m,on_ground,depth_extent_m,share,region,year,n\n"
        " pole , rod ; ;stick, , 1.0 ,0.1,,,,,,,\n"
    )
    found = PriorTable.from_csv(write(tmp_path / "a.csv", text))
    assert found == PriorTable([ObjectPrior("pole", 1.0, 0.1, aliases=("rod", "stick"))])


@pytest.mark.parametrize("word", ["false", "False", "FALSE"])
def test_on_ground_is_read_whatever_its_case(tmp_path, word):
    file = write(tmp_path / "a.csv", f"{HEADER},on_ground\npole,1.0,0.1,{word}\n")
    assert [row.on_ground for row in PriorTable.from_csv(file)] == [False]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_files_saved_by_spreadsheets_are_read(tmp_path, encoding, newline):
    file = tmp_path / "a.csv"
    file.write_bytes(newline.join([HEADER, "Mönch,1.0,0.1", ""]).encode(encoding))
    assert PriorTable.from_csv(file).labels == ("Mönch",)


def test_header_alone_is_an_empty_table(tmp_path):
    assert len(PriorTable.from_csv(write(tmp_path / "a.csv", f"{HEADER}\n"))) == 0


@pytest.mark.parametrize(
    ("region", "means"), [("world", [2.0, 1.0]), ("eu", [2.1, 1.0]), ("us", [2.0, 1.0])]
)
def test_rows_of_a_region_replace_the_worlds_in_a_file(tmp_path, region, means):
    text = f"{HEADER},region\ndoor,2.0,0.1,world\ndoor,2.1,0.1,eu\npole,1.0,0.1,\n"
    table = PriorTable.from_csv(write(tmp_path / "a.csv", text), region=region)
    assert [row.mean_m for row in table] == means


def test_rows_of_a_region_replace_the_worlds_however_the_label_is_spelt(tmp_path):
    text = f"{HEADER},region\nMy Pole,1.0,0.1,world\nmy_pole,1.1,0.1,eu\n"
    file = write(tmp_path / "a.csv", text)
    assert [row.mean_m for row in PriorTable.from_csv(file, region="eu")] == [1.1]
    assert [row.mean_m for row in PriorTable.from_csv(file)] == [1.0]


def test_a_regions_row_on_one_axis_leaves_the_worlds_on_another(tmp_path):
    text = (
        f"{HEADER},axis,region\n"
        "door,2.0,0.1,height,world\ndoor,0.8,0.1,width,world\ndoor,2.1,0.1,height,eu\n"
    )
    table = PriorTable.from_csv(write(tmp_path / "a.csv", text), region="eu")
    assert {row.axis: row.mean_m for row in table} == {"height": 2.1, "width": 0.8}


def test_label_that_exists_in_another_region_only_is_refused(tmp_path):
    file = write(tmp_path / "a.csv", f"{HEADER},region\npole,1.0,0.1,eu\n")
    assert len(PriorTable.from_csv(file, region="eu")) == 1
    with pytest.raises(ValueError, match=r"a\.csv must have a row for region .*pole"):
        PriorTable.from_csv(file, region="us")


@pytest.mark.parametrize(
    ("header", "law"),
    [
        pytest.param("label,mean_m", "no std_m", id="one missing"),
        pytest.param("name,size", "no label, mean_m, std_m; unknown name, size", id="all wrong"),
        pytest.param(f"{HEADER},mean_cm", "unknown mean_cm", id="one unknown"),
        pytest.param("Label,mean_m,std_m", "no label; unknown Label", id="wrong case"),
        pytest.param("label;mean_m;std_m", "no label, mean_m, std_m", id="wrong separator"),
        pytest.param("", "no label, mean_m, std_m", id="empty file"),
    ],
)
def test_missing_and_unknown_columns_are_all_named(tmp_path, header, law):
    file = write(tmp_path / "mine.csv", header and f"{header}\n")
    with pytest.raises(ValueError, match=rf"mine\.csv must have the columns.*got.*{law}"):
        PriorTable.from_csv(file)


def test_every_bad_row_is_named_with_its_line_and_its_law(tmp_path):
    text = (
        f"{HEADER},axis,on_ground,year\n"
        "pole,1.0,0.1,,,\n"
        "rod,-1.0,0.1,,,\n"
        "mast,tall,0.1,,,\n"
        "bar,1.0,0.1,length,,\n"
        "car,151,12,,,\n"
        "beam,1.0,0.1,,perhaps,\n"
        ",1.0,0.1,,,\n"
        "ok,1.0,0.1,,true,2019\n"
    )
    with pytest.raises(ValueError, match=r"mine\.csv must hold lawful rows; got 6 bad") as caught:
        PriorTable.from_csv(write(tmp_path / "mine.csv", text))
    message = str(caught.value)
    for line, law in (
        (3, "`mean_m` must be finite and positive; got -1.0"),
        (4, "tall"),
        (5, '`axis` must be one of "height", "width", "diameter"; got \'length\''),
        (6, '`mean_m` of "car" must be in metres; got 151.0'),
        (7, "`on_ground` must be true or false; got 'perhaps'"),
        (8, "label"),
    ):
        assert re.search(rf"line {line}: [^|]*{re.escape(law)}", message), (line, message)
    assert "line 2" not in message
    assert "line 9" not in message


@pytest.mark.parametrize(
    ("column", "law"),
    [
        ("mean_m", "a number"),
        ("std_m", "a number"),
        ("year", "a whole number"),
        ("n", "a whole number"),
    ],
)
def test_a_cell_that_is_no_number_is_named_by_its_column(tmp_path, column, law):
    cells = {"label": "pole", "mean_m": "1.0", "std_m": "0.1", "year": "", "n": ""}
    cells[column] = "1.0m"
    text = f"{','.join(cells)}\n{','.join(cells.values())}\n"
    with pytest.raises(ValueError, match=rf"line 2: `{column}` must be {law}; got '1\.0m'"):
        PriorTable.from_csv(write(tmp_path / "a.csv", text))


@pytest.mark.parametrize(
    "row", [pytest.param("pole,1.0", id="too short"), pytest.param("pole,1,5,0,1", id="too long")]
)
def test_row_of_another_length_is_refused(tmp_path, row):
    file = write(tmp_path / "a.csv", f"{HEADER}\nrod,1.0,0.1\n{row}\n")
    with pytest.raises(ValueError, match=r"line 3: .*as many cells as the header"):
        PriorTable.from_csv(file)


@pytest.mark.parametrize("missing", ["label", "mean_m", "std_m"])
def test_row_without_a_needed_cell_is_refused_naming_it(tmp_path, missing):
    cells = {"label": "pole", "mean_m": "1.0", "std_m": "0.1", missing: ""}
    file = write(tmp_path / "a.csv", f"{HEADER}\n{','.join(cells.values())}\n")
    with pytest.raises(ValueError, match=rf"line 2: .*{missing}"):
        PriorTable.from_csv(file)


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "0"])
def test_cells_that_are_not_positive_lengths_are_refused(tmp_path, word):
    file = write(tmp_path / "a.csv", f"{HEADER}\npole,{word},0.1\n")
    with pytest.raises(
        ValueError, match=r"line 2: `mean_m` must be (a number|finite and positive)"
    ):
        PriorTable.from_csv(file)


def test_name_of_two_labels_in_a_file_is_refused(tmp_path):
    text = f"{HEADER},aliases\npole,1.0,0.1,rod\nmast,9.0,0.1,Rod\n"
    with pytest.raises(ValueError, match='got "rod" for "pole" and for "mast"'):
        PriorTable.from_csv(write(tmp_path / "a.csv", text))


def test_missing_file_is_a_file_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        PriorTable.from_csv(tmp_path / "nowhere.csv")
