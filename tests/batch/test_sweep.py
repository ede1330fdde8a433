"""Sweeps over keys of a camera file."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from pydantic import ValidationError

from clplen.batch.jobs.sweep import Setting, SweepTable, combinations, label, with_values
from clplen.batch.jobs.tables import SceneTable, SimulationTable
from clplen.config.tables import problems_of

CONTENT: dict[str, Any] = {
    "camera": {"wavelength_nm": 532.0, "microlenses": {"pitch_um": 150.0, "count": [20, 24]}},
    "scene": {"points_mm": [[-3.0, -2.0, -50.0], [0.0, 1.0, 2.0]]},
}


def sweeps(*pairs: tuple[str, list[Any]], **names: str) -> list[SweepTable]:
    return [SweepTable(key=key, values=values, name=names.get(key)) for key, values in pairs]


def labels(*pairs: tuple[str, list[Any]], **names: str) -> list[str]:
    return [label(chosen) for chosen in combinations(sweeps(*pairs, **names))]


def put(key: str, value: Any) -> dict[str, Any]:
    return with_values(CONTENT, [Setting(key, value, "")])


def test_the_last_key_runs_fastest():
    found = combinations(sweeps(("a.x", [1, 2]), ("b.y", [3, 4, 5])))
    pairs = [[(one.key, one.value) for one in chosen] for chosen in found]
    assert pairs == [[("a.x", x), ("b.y", y)] for x in (1, 2) for y in (3, 4, 5)]
    assert combinations([]) == [[]]


def test_names_of_combinations():
    swept = sweeps(("scene.points_mm.*.2", [-100, 50.5]), ("camera.microlenses.pitch_um", [150]))
    swept[0] = swept[0].model_copy(update={"name": "dz_mm"})
    assert [label(chosen) for chosen in combinations(swept)] == [
        "dz_mm=-100_pitch_um=150",
        "dz_mm=50.5_pitch_um=150",
    ]
    assert label([]) == ""


def test_keys_with_the_same_last_word_are_told_apart():
    for keys, expected in (
        (["a.pitch_um", "b.c.pitch_um"], ["a.pitch_um", "c.pitch_um"]),
        (["scene.points_mm.0.2", "scene.points_mm.1.2"], ["points_mm.0.2", "points_mm.1.2"]),
        (["scene.points_mm.0.2", "scene.power.0"], ["points_mm", "power"]),
        (["a.b.x", "c.b.x", "x"], ["a.b.x", "c.b.x", "x"]),
    ):
        (found,) = labels(*((key, [1]) for key in keys))
        assert found == "_".join(f"{name}=1" for name in expected)


def test_a_given_name_stays_as_it_is():
    swept = [SweepTable(key="a.x", values=[1]), SweepTable(key="b.y", values=[2], name="x")]
    assert [label(chosen) for chosen in combinations(swept)] == ["a.x=1_x=2"]


def test_values_in_names_are_short_and_distinct():
    for values, expected in (
        ([1, 2.5], ["1", "2.5"]),
        ([0.1 + 0.2, 1 / 3], ["0.3", "0.333333"]),
        ([1.0, 1.0 + 1e-9], ["1", "1.000000001"]),
        ([1.0, math.nextafter(1.0, 2)], ["1", "1.0000000000000002"]),
        ([True, False], ["true", "false"]),
        ([[20, 24], 30], ["20x24", "30"]),
        (["pictures/a.png", "pictures/b c.png"], ["pictures-a.png", "pictures-b-c.png"]),
        (["a b", "a/b"], ["a-b-0", "a-b-1"]),
        (["Mask", "mask"], ["Mask-0", "mask-1"]),
        ([{"x": 1, "y": "b"}], ["1xb"]),
        (["q" * 300], ["q" * 40]),
    ):
        assert labels(("k", values)) == [f"k={text}" for text in expected]


def test_a_copy_is_changed():
    before = copy.deepcopy(CONTENT)
    value = [7.0, 8.0, 9.0]
    found = put("scene.points_mm.1", value)
    assert found["scene"]["points_mm"] == [[-3.0, -2.0, -50.0], [7.0, 8.0, 9.0]]
    value[0] = 0.0
    assert found["scene"]["points_mm"][1][0] == 7.0
    assert before == CONTENT


def test_entries_of_lists():
    for key, expected in (
        ("scene.points_mm.*.2", [[-3.0, -2.0, 4], [0.0, 1.0, 4]]),
        ("scene.points_mm.0.1", [[-3.0, 4, -50.0], [0.0, 1.0, 2.0]]),
        ("scene.points_mm.*", [4, 4]),
        ("scene.points_mm", 4),
    ):
        assert put(key, 4)["scene"]["points_mm"] == expected


def test_a_key_may_be_new_to_its_table():
    assert put("camera.field_lens", True)["camera"]["field_lens"] is True
    assert put("camera.microlenses.pitch_um", 99)["camera"]["microlenses"]["pitch_um"] == 99


def test_a_key_that_leads_nowhere():
    for key, said in (
        ("camera.microlens.pitch_um", "camera has no table 'microlens'; did you mean microlenses?"),
        ("scen.points_mm.0.2", "the file has no table 'scen'; did you mean scene?"),
        ("sensor.seed", "the file has no table 'sensor'; tables: camera, scene"),
        (
            "scene.points_mm.2.2",
            r"scene\.points_mm is a list with the entries 0 to 1 \(\* for all\), not '2'",
        ),
        ("scene.points_mm.1.3", r"scene\.points_mm\.1 is a list with the entries 0 to 2 .*not '3'"),
        ("camera.wavelength_nm.0", r"camera\.wavelength_nm is 532\.0, not a table"),
    ):
        with pytest.raises(
            ValueError, match=f"^the key {key!r} does".replace("*", r"\*") + ".*" + said
        ):
            put(key, 1)


def problems(**words: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        SimulationTable.model_validate({"camera": "camera.toml", **words})
    return problems_of(SimulationTable, caught.value)


def test_what_is_said_about_a_wrong_sweep():
    for sweep, said in (
        ([{"key": "a", "values": []}], "sweep.0.values must be a list of at least one value"),
        ([{"key": "a", "values": [3, 4, 3.0]}], "sweep.0.values must not repeat 3.0"),
        ([{"key": "a..b", "values": [3]}], "sweep.0.key"),
        ([{"key": "a"}], "sweep.0.values is missing"),
        ([{"key": "a", "value": [3]}], "unknown key sweep.0.value; did you mean values?"),
        (
            [{"key": "a.b", "values": [3]}, {"key": "a.b", "values": [4]}],
            "sweeps a.b and a.b, which set the same value: leave one out",
        ),
        (
            [{"key": "a.*.2", "values": [3]}, {"key": "a.1.2", "values": [4]}],
            "sweeps a.*.2 and a.1.2, which set the same value",
        ),
        (
            [{"key": k, "values": [3], "name": "x"} for k in ("a.b", "a.c")],
            "has the name 'x' for a.b and a.c",
        ),
    ):
        assert said in problems(sweep=sweep)


def test_what_is_said_about_wrong_scenes():
    for words, said in (
        ({"kind": "sphere"}, "kind must be a kind of scene, not 'sphere'; did you mean spheres?"),
        (
            {"kind": ["bars", "q"]},
            "kind must be a kind of scene, not 'q'; use any of plane, slant, layers",
        ),
        ({"kind": []}, "kind"),
        ({"kind": "all", "noise": -0.1}, "noise must be 0 or more"),
        (
            {"kind": "all", "sweep": [{"key": "sensor.seed", "values": [1]}]},
            "sweeps sensor.seed, but without a camera only shape, views, noise can be swept",
        ),
        ({"kind": "all", "camera": "a", "views": [9, 9]}, "has views and a camera, whose lenslets"),
    ):
        with pytest.raises(ValidationError) as caught:
            SceneTable.model_validate(words)
        assert said in problems_of(SceneTable, caught.value)


def test_one_kind_and_one_seed():
    table = SceneTable.model_validate({"kind": "bars", "seeds": 3})
    assert (table.kind, table.seeds, table.shape) == (["bars"], [3], (512, 512))
