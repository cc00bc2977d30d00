"""The packaged configuration documents every default; layers lie over it;
faults are told at once with place and remedy."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from posegaussian.dags.config.effect_settings import EffectSettings
from posegaussian.dags.config.settings import PACKAGED, Configuration, Settings, load_configuration, merge
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.errors import ConfigError


def load(folder: Path, text: str = "", *assignments: str) -> Configuration:
    file = folder / "own.yaml"
    file.write_text(text, encoding="utf-8")
    return load_configuration(file, assignments, folder)


def faults(folder: Path, text: str = "", *assignments: str) -> list[str]:
    with pytest.raises(ConfigError) as error:
        load(folder, text, *assignments)
    return str(error.value).replace(str(folder) + "/", "").splitlines()


def leaves(model: BaseModel, prefix: str = "") -> dict[str, Any]:
    """{dotted key: default} of every field; a section is any field that holds a model."""
    found: dict[str, Any] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        found |= leaves(value, f"{prefix}{name}.") if isinstance(value, BaseModel) else {prefix + name: value}
    return found


def written(values: dict[str, Any], sections: set[str], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= written(value, sections, f"{prefix}{key}.") if prefix + key in sections else {prefix + key: value}
    return found


PACKAGED_VALUES = yaml.safe_load(PACKAGED.read_text(encoding="utf-8"))
SECTIONS = {name for name in Settings.model_fields if isinstance(getattr(Settings(), name), BaseModel)}
DEFAULTS = leaves(Settings())
DOCUMENTED = written({k: v for k, v in PACKAGED_VALUES.items() if k != "sequences"}, SECTIONS)


def test_the_packaged_file_has_a_section_for_every_stage() -> None:
    assert {s.name for s in STAGES} <= SECTIONS
    assert [k for k in PACKAGED_VALUES if k in {s.name for s in STAGES}] == [s.name for s in STAGES], (
        "in the order of flow"
    )


@pytest.mark.parametrize("key", sorted(DEFAULTS))
def test_every_field_is_documented_in_the_packaged_file_with_its_default(key: str) -> None:
    assert key in DOCUMENTED, (
        f"{key} is missing in {PACKAGED.name}; add it with its default {DEFAULTS[key]!r} and a comment"
    )
    assert DOCUMENTED[key] == DEFAULTS[key], (
        f"{PACKAGED.name} says {key}: {DOCUMENTED[key]!r}, the model's default is {DEFAULTS[key]!r}"
    )


def test_the_packaged_file_says_nothing_else() -> None:
    assert DOCUMENTED.keys() - DEFAULTS.keys() == set()
    assert PACKAGED_VALUES["sequences"] == {}


def test_every_line_of_the_packaged_file_that_sets_a_value_has_a_comment() -> None:
    for number, line in enumerate(PACKAGED.read_text(encoding="utf-8").splitlines(), 1):
        if line.strip() and not line.rstrip().endswith(":"):
            assert "#" in line, f"{PACKAGED.name}:{number}: {line.strip()} has no comment"


def test_the_configuration_at_the_root_is_the_packaged_one() -> None:
    assert (PACKAGED.resolve().parents[2] / "pipeline.yaml").resolve() == PACKAGED.resolve()


def test_without_a_file_the_packaged_defaults_hold(tmp_path: Path) -> None:
    assert load_configuration(folder=tmp_path).default == Settings()


def test_a_partial_file_is_laid_over_the_defaults(tmp_path: Path) -> None:
    c = load(tmp_path, "smoothing: {omega: 0.5}\nviews: {held_out: [cam03]}\n")
    packaged = leaves(load_configuration(folder=tmp_path).default)
    changed = {k: v for k, v in leaves(c.default).items() if v != packaged[k]}
    assert changed == {"smoothing.omega": 0.5, "views.held_out": ["cam03"]}


def test_the_folders_own_file_is_read_unless_another_is_named(tmp_path: Path) -> None:
    (tmp_path / "pipeline.yaml").write_text("depth: {pairs: 1}\n")
    assert load_configuration(folder=tmp_path).default.depth.pairs == 1
    assert load(tmp_path, "smoothing: {omega: 0.5}").default.depth.pairs == DEFAULTS["depth.pairs"]


def test_merging_replaces_lists_and_scalars_and_keeps_its_operands() -> None:
    below, above = {"a": {"x": [1, 2], "y": 1}, "b": 1}, {"a": {"x": [3]}, "c": {"z": 1}}
    assert merge(below, above) == {"a": {"x": [3], "y": 1}, "b": 1, "c": {"z": 1}}
    assert below == {"a": {"x": [1, 2], "y": 1}, "b": 1}
    assert merge(merge({}, below), {}) == below


def test_set_wins_over_the_file_and_values_are_yaml(tmp_path: Path) -> None:
    c = load(
        tmp_path,
        "depth: {method: sgbm, pairs: 1}\n",
        "depth.method=hull",
        "views.held_out=[a, b]",
        "frames.size=64",
        "frames.range=0:96:2",
        "frames.size=null",
    )
    assert (c.default.depth.method, c.default.depth.pairs) == ("hull", 1)
    assert c.default.views.held_out == ["a", "b"]
    assert c.default.frames.range == "0:96:2"
    assert c.default.frames.size is None


def test_several_faults_are_told_at_once_with_place_and_suggestion(tmp_path: Path) -> None:
    text = "depth:\n  pairs: 9\n  metod: hull\nsmoothng:\n  omega: 1\nframes: {range: 'a:b'}\nsmoothing: {omega: 7}\n"
    assert sorted(faults(tmp_path, text)) == sorted(
        [
            "own.yaml:2:3 depth.pairs: input should be less than or equal to 4, got 9",
            'own.yaml:3:3 depth.metod: unknown key; did you mean "method"?',
            'own.yaml:4:1 smoothng: unknown key; did you mean "smoothing"?',
            "own.yaml:6:10 frames.range: range 'a:b' is not made of integers, for example 0:96:2",
            "own.yaml:7:13 smoothing.omega: input should be less than or equal to 1, got 7",
        ]
    )


@pytest.mark.parametrize("key", sorted(k for k in DEFAULTS if len(k.rpartition(".")[2]) > 3))
def test_every_key_misspelt_by_one_letter_is_suggested(tmp_path: Path, key: str) -> None:
    section, _, name = key.rpartition(".")
    misspelt = name[:-2] + name[-1]
    text = f"{section}: {{{misspelt}: 1}}\n" if section else f"{misspelt}: 1\n"
    (sentence,) = faults(tmp_path, text)
    assert re.search(r"own\.yaml:1:\d+ .*unknown key; did you mean \"", sentence)
    assert f'"{name}"' in sentence


def test_a_key_like_no_other_lists_the_known_ones(tmp_path: Path) -> None:
    (sentence,) = faults(tmp_path, "metrics: {qqqq: 1}\n")
    assert (
        sentence == "own.yaml:1:11 metrics.qqqq: unknown key; known are"
        f" {', '.join(k.partition('.')[2] for k in DEFAULTS if k.startswith('metrics.'))}"
    )


def test_a_misspelt_key_of_a_camera_s_crop_is_suggested_from_the_crop(tmp_path: Path) -> None:
    assert faults(tmp_path, "frames: {crop: {cam01: {scal: 2}}}") == [
        'own.yaml:1:25 frames.crop.cam01.scal: unknown key; did you mean "scale"?'
    ]


def test_a_fault_of_set_is_named_as_such(tmp_path: Path) -> None:
    assert faults(tmp_path, "depth: {pairs: 3}", "depth.pairs=0") == [
        "--set depth.pairs: input should be greater than or equal to 1, got 0"
    ]
    assert faults(tmp_path, "", "depth.metod=hull") == ['--set depth.metod: unknown key; did you mean "method"?']


@pytest.mark.parametrize(
    "assignment", ["depth.method", "=hull", "depth.method=[1", "depth.method=!x y", "archive=\tx: 1: 2"]
)
def test_a_malformed_set_is_shown_as_written(tmp_path: Path, assignment: str) -> None:
    assert faults(tmp_path, "", assignment)[0].startswith(f"--set {assignment}: ")


def test_set_cannot_go_below_a_value(tmp_path: Path) -> None:
    assert faults(tmp_path, "", "depth=5", "depth.method=hull") == [
        "--set depth.method=hull: depth was already given a value and cannot hold method"
    ]


@pytest.mark.parametrize(
    "text",
    [
        "depth: hull",
        "depth: [1]",
        "frames: {crop: [1]}",
        "views: {sources: cam01}",
        "views: {sources: [1, 2]}",
        "rendering: {paths: orbit}",
        "effects: 5",
        "effects: abc",
        "sequences: 5",
        "sequences: {a: 5}",
        "sequences: {a: null}",
        "frames: {size: 1e-3}",
        "smoothing: {omega: .nan}",
    ],
)
def test_a_value_of_the_wrong_type_is_a_sentence_with_its_place(tmp_path: Path, text: str) -> None:
    found = faults(tmp_path, text)
    assert found
    assert all(re.match(r"own\.yaml:1:\d+ [\w.]+: .*, got ", f) for f in found), found


def test_no_setting_may_be_nan_or_infinite(tmp_path: Path) -> None:
    for key, value in DEFAULTS.items():
        if isinstance(value, float):
            for bad in (".nan", ".inf", "-.inf"):
                assert faults(tmp_path, "", f"{key}={bad}")
    assert faults(tmp_path, "depth: {depth_range: [.nan, 3]}")
    assert faults(tmp_path, "frames: {crop: {a: {offset: [.nan, 0]}}}")


def test_an_unknown_effect_is_named_at_the_top_and_inside_overrides(tmp_path: Path) -> None:
    known = ", ".join(EffectSettings.model_fields)
    assert faults(tmp_path, "effects:\n  fog: on\nsequences:\n  kick*:\n    effects: {undistorsion: off}\n") == [
        f"own.yaml:2:3 effects.fog: unknown key; known are {known}",
        'own.yaml:5:15 sequences.kick*.effects.undistorsion: unknown key; did you mean "undistortion"?',
    ]


@pytest.mark.parametrize("word", ["on", "off", "auto", "'on'", "true", "false"])
def test_an_effect_is_auto_on_or_off_however_yaml_reads_the_word(tmp_path: Path, word: str) -> None:
    meant = {"true": "on", "false": "off"}.get(word, word.strip("'"))
    assert load(tmp_path, f"effects: {{undistortion: {word}}}").default.effects.undistortion == meant
    assert load(tmp_path, "", f"effects.undistortion={word}").default.effects.undistortion == meant
    c = load(tmp_path, f"sequences: {{kick: {{effects: {{left_right_check: {word}}}}}}}")
    assert (c.default.effects.left_right_check, c.for_sequence("kick").effects.left_right_check) == ("auto", meant)


@pytest.mark.parametrize("word", ["onn", "1", "null", "[on]"])
def test_any_other_word_for_an_effect_is_a_fault_with_its_place(tmp_path: Path, word: str) -> None:
    (found,) = faults(tmp_path, f"effects:\n  undistortion: {word}\n")
    assert found.startswith("own.yaml:2:3 effects.undistortion: input should be 'auto', 'on' or 'off', got ")


OVERRIDES = """\
smoothing: {omega: 0.9}
sequences:
  "kick*": {smoothing: {omega: 0.5}, depth: {pairs: 1}}
  "*fast": {smoothing: {omega: 0.6}}
  jump: {views: {held_out: [cam02]}}
"""


def test_overrides_apply_by_glob_in_the_order_of_the_file(tmp_path: Path) -> None:
    c = load(tmp_path, OVERRIDES)

    def of(name: str) -> tuple[float, int, list[str] | None]:
        s = c.for_sequence(name)
        return s.smoothing.omega, s.depth.pairs, s.views.held_out

    pairs = DEFAULTS["depth.pairs"]
    assert of("walk") == (0.9, pairs, None)
    assert of("kick") == of("kick_slow") == (0.5, 1, None)
    assert of("kick_fast") == (0.6, 1, None)
    assert of("jump") == (0.9, pairs, ["cam02"])
    assert of("KICK") == of("walk"), "globs mind the case"
    assert c.default.smoothing.omega == 0.9


def test_overrides_that_no_sequence_has_are_told_with_the_nearest_name(tmp_path: Path) -> None:
    c = load(tmp_path, OVERRIDES)
    assert c.idle(["walk", "kick", "jump", "kick_fast"]) == []
    (line,) = c.idle(["kick", "kick_fast", "jumps"])
    assert line == 'the settings under sequences.jump are for no sequence of this archive; did you mean "jumps"?'


def test_set_lies_below_the_overrides_of_a_sequence(tmp_path: Path) -> None:
    c = load(tmp_path, OVERRIDES, "smoothing.omega=0.1")
    assert c.for_sequence("walk").smoothing.omega == 0.1
    assert c.for_sequence("kick").smoothing.omega == 0.5
    assert load(tmp_path, OVERRIDES, "sequences.kick*.smoothing.omega=0.2").for_sequence("kick").smoothing.omega == 0.2


def test_faults_inside_overrides_have_their_own_place_and_only_theirs(tmp_path: Path) -> None:
    text = (
        "sequences:\n  kick*:\n    smoothing: {omega: 3, omga: 1}\n    dept: {pairs: 1}\n    archive: elsewhere\n   "
        " run: {workers: 1}\n  ok: {depth: {pairs: 1}}\n"
    )
    assert sorted(faults(tmp_path, text)) == sorted(
        [
            "own.yaml:3:17 sequences.kick*.smoothing.omega: input should be less than or equal to 1, got 3",
            'own.yaml:3:27 sequences.kick*.smoothing.omga: unknown key; did you mean "omega"?',
            'own.yaml:4:5 sequences.kick*.dept: unknown key; did you mean "depth"?',
            "own.yaml:5:5 sequences.kick*.archive: cannot differ between sequences; set it at the top level",
            "own.yaml:6:5 sequences.kick*.run: cannot differ between sequences; set it at the top level",
        ]
    )
    assert len(faults(tmp_path, "depth: {pairs: 9}\nsequences: {a: {smoothing: {omega: 0.5}}}")) == 1


@pytest.mark.parametrize("text", ["100:", ":100", "::2", "10::", " 100: ", "0:"])
def test_open_ended_ranges_are_set_as_they_are_written(tmp_path: Path, text: str) -> None:
    assert load(tmp_path, "", f"frames.range={text}").default.frames.range == text.strip()


def test_a_range_that_is_none_is_told_as_one(tmp_path: Path) -> None:
    assert faults(tmp_path, "", "frames.range=-1:") == [
        "--set frames.range: range '-1:': start and stop must not be negative and the stride at least 1"
    ]
    (line,) = faults(tmp_path, "frames:\n  range: 1:\n")
    assert line.startswith("own.yaml:2:11: not valid YAML: mapping values are not allowed here")
    assert line.endswith("; put a text that holds a colon in quotes")


def test_settings_under_a_name_with_brackets_are_for_that_sequence(tmp_path: Path) -> None:
    c = load(tmp_path, "sequences: {'walk[a]': {depth: {pairs: 1}}, 'kick[12]': {depth: {pairs: 2}}}")
    assert c.for_sequence("walk[a]").depth.pairs == 1
    assert c.for_sequence("kick2").depth.pairs == 2
    assert c.idle(["walk[a]", "kick1"]) == []


def test_duplicate_keys_and_broken_yaml_stop_before_anything_else(tmp_path: Path) -> None:
    assert faults(tmp_path, "depth: {pairs: 1}\ndepth: {pairs: 2}\n") == [
        "own.yaml:2:1 depth: given twice, first at own.yaml:1:1"
    ]
    assert faults(tmp_path, "depth: [1\n")[0].startswith("own.yaml:2:1: not valid YAML")


def test_the_effective_settings_written_as_yaml_lead_to_the_same_settings(tmp_path: Path) -> None:
    c = load(
        tmp_path, OVERRIDES, "frames.range=0:96:2", "depth.depth_range=[1, 5]", "frames.crop={cam01: {scale: 0.5}}"
    )
    again = load(tmp_path, c.as_yaml())
    for name in ("walk", "kick", "kick_fast", "jump"):
        assert again.for_sequence(name) == c.for_sequence(name)


def test_settings_cannot_be_changed_afterwards(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frozen"):
        load(tmp_path).default.depth.pairs = 3


def test_a_key_of_another_stage_is_found_there() -> None:
    with pytest.raises(ConfigError, match=r'pose\.estimator: unknown key; did you mean "detection\.estimator"\?'):
        load_configuration(None, ["pose.estimator=blazepose"])
