"""The figure scripts: each is indexed and draws from tiny made-up runs; page and tables say what they should."""

from __future__ import annotations

import inspect
import io
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.image import AxesImage
from skimage.io import imread

from experiments import ablate, bench_dataset, fit_threshold, reproduce_paper
from experiments.common import paper
from experiments.common.frames import sonar_for
from experiments.common.runs import Run, load
from experiments.common.tables import correlation_table, receiver_curve
from paper_figs import ablations, baseline, docs_pages, docs_slice, fig05, index, readme, report, style
from paper_figs.__main__ import main
from sonarjax.io import SonarjaxError, write_npz
from sonarjax.scene import objects

PROJECT = Path(__file__).resolve().parent.parent
SHAPE = (512, 96)
SEGMENTERS = ("pix2pix", "none")
SEVERITY = "ablate --vary severity"
WANTED = [*(f"fig{k:02}" for k in range(1, 9)), "tab03", "tab04", "sec32", "sec43", "sec44"]
OWN = 13  # at least so many figures of our own
PAPER = {
    "tab03": [np.mean([0.6837, 0.7697, 0.5776, 0.7162]), 0.5715, 0.0],
    "tab04": [np.mean([0.5972, 0.6446, 0.4726, 0.5735]), 0.4709],
    "sec32": [1.2],  # hours of training
    "sec43": [25.57, 35.93, 10.36, 10.36, 0.638],  # PSNR before and after, its gain on two crops [dB], IoU
    "sec44": [0.9201],  # accuracy
}


# ---------------------------------------------------------------- runs that no experiment made


def finish(runs: Path, experiment: str, results: dict[str, Any], *, preset: str = "full", **arrays: Any) -> None:
    """A finished run: `arrays` are dicts of arrays by the name of their file."""
    name, *options = experiment.split()
    folder = runs / name / "-".join(["made-up", *options[1:], "s0"])
    folder.mkdir(parents=True)
    facts = {"experiment": experiment, "preset": preset, "seed": 0, "settings": {}, "versions": {"sonarjax": "0"}}
    facts |= {"git": "0123456789", "code": "c0de", "device": "cpu", "date": "2020-02-02", "seconds": 1.0}
    facts["command"] = f"python -m experiments.{experiment}"
    (folder / "results.json").write_text(json.dumps(facts | results), encoding="utf-8")
    for name, values in arrays.items():
        write_npz(folder / f"{name}.npz", **{key: np.asarray(value) for key, value in values.items()})


def row(rng: np.random.Generator, *keys: str, **more: Any) -> dict[str, Any]:
    return {key: float(rng.uniform(0.2, 0.9)) for key in keys} | more


def maps(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Noisy frames and true maps (frame, range, beam)."""
    clean = np.full((count, *SHAPE), 0.5, np.float32)
    clean[:, 170:190, 40:56], clean[:, 190:270, 42:54] = 1.0, 0.0
    return np.clip(clean + rng.normal(0, 0.2, clean.shape), 0, 1).astype(np.float32), clean


def make_scenes(runs: Path, rng: np.random.Generator) -> None:
    image, clean = maps(rng, 2)
    corners = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    names = ("concrete cylinder", "plastic ball", "clay brick", "target", "non-target")
    finish(
        runs,
        "paper_scenes",
        {"shapes": {"fig02": {"image": "2"}}},
        fig02={"image": image, "clean": clean, "yaw_deg": [0, 90], "tilt_deg": 20.0},
        fig03={"templates": clean[[0, 1, 0, 1], 150:300, 30:66], "yaw_deg": [0, 90, 180, 270], "offset": [150, 30],
               "tilt_deg": 20.0},
        fig04={f"{name}/{key}": v for name in names for key, v in (("vertices", corners), ("faces", faces))},
        fig05={"image": rng.uniform(size=(2, 128, 128)), "labels": rng.integers(0, 3, (2, 128, 128))},
    )  # fmt: skip


def make_reproduction(runs: Path, rng: np.random.Generator, preset: str = "full") -> None:
    own, yaw = np.repeat([True, False] * 4, 4), np.tile([0.0, 90.0, 180.0, 270.0], 8)
    image, clean = maps(rng, 8)
    kept = {"image": image, "semantic": clean, "truth": clean, "is_target": [True] * 4 + [False] * 4,
            "tilt_deg": [15.0, 20.0, 25.0, 20.0] * 2}  # fmt: skip
    arrays, rows, tables = {}, [], {}
    for name, table in zip(SEGMENTERS, ("tab03", "tab04"), strict=True):
        scores = rng.uniform(0.3, 0.8, (32, 36))
        false, true, area = receiver_curve(scores.max(axis=1), own)
        arrays[f"grid_{name}"] = {"scores": scores, "score": scores.max(axis=1), "is_target": own, "yaw_deg": yaw,
                                  "false_positive": false, "true_positive": true}  # fmt: skip
        arrays[f"maps_{name}"] = kept
        tables[table] = correlation_table(scores, yaw, own)
        keys = (*reproduce_paper.HEADS, "psnr", "psnr_raw", "psnr_gain", "psnr_gain_wide", "threshold")
        rows.append(row(rng, *keys, auc=area, segmenter=name))
    lines = reproduce_paper.beside_the_paper(rows, tables, 32)
    plain = {item: {k: np.asarray(v).tolist() for k, v in table.items()} for item, table in tables.items()}
    finish(runs, "reproduce_paper", {"rows": lines, "segmenters": rows, "tables": plain}, preset=preset, **arrays)


def make_bench(runs: Path) -> None:
    rows = [{"width": width, "work": "training", "images": {"ours": 80.0 / width, "torch": 100.0 / width}}
            for width in (16, 64)]  # fmt: skip
    finish(runs, "bench_train", {"rows": rows, "cores": 2})


def make_yaws(runs: Path, rng: np.random.Generator) -> None:
    errors: dict[str, Any] = {"sorted_floor_deg": np.linspace(0, 5, 20)}
    for name in SEGMENTERS:
        errors |= {f"{name}_error_deg": rng.normal(0, 1, 20), f"{name}_std_deg": np.ones(20)}
        errors |= {f"sorted_{name}_{key}_deg": np.sort(rng.uniform(0, 5, 20)) for key in ("error", "bin_error")}
    cost = [row(rng, "single", "each", what=what) for what in ("refine_yaw", "recognize")]
    lines = [
        row(rng, "median", segmenter=name, yaw=yaw) for name in SEGMENTERS for yaw in ("best of the grid", "refined")
    ]
    settings = {"settings": {"segmenters": SEGMENTERS}}
    finish(runs, "continuous_yaw", settings | {"errors": lines, "cost": cost}, errors=errors)
    starts = (-5.0, 0.0, 5.0)
    basin = [row(rng, "within_1", "within_2", map="labels", blurs=blurs, start_deg=s) for blurs in "ab" for s in starts]
    finish(runs, "yaw_basin", {"rows": basin})
    land = {"yaw_deg": np.linspace(-40, 40, 5), "x_m": np.linspace(-0.1, 0.1, 5), "loss": rng.uniform(size=(5, 5, 2)),
            "path": rng.uniform(-0.05, 0.05, (3, 2, 2)), "end": np.zeros((2, 2))}  # fmt: skip
    slopes = {"blur": [8.0, 0.8]}
    slopes |= {f"labels_{key}": rng.normal(size=(1, 9, 2)) for key in ("derivative", "differences")}
    found = {"settings": {"maps": ["labels"]}, "derivatives": [row(rng, "error", "sign", map="labels")]}
    finish(runs, "yaw_landscape", found, derivatives=slopes, landscape_labels=land)
    yaws = {"square_box_true_yaw_deg": rng.uniform(0, 360, 6), "square_box_truth_yaw_deg": rng.uniform(0, 360, (6, 2))}
    box = {"object": "square box", "period_deg": 90.0, "segmenter": "truth"}
    finish(runs, "symmetric_objects", {"rows": [box]}, hypotheses=yaws)


def make_ablations(runs: Path, rng: np.random.Generator) -> None:
    for vary, sweep in ablate.SWEEPS.items():
        curve = {"images": [8.0, 16.0], "iou_mean": [0.1, 0.3]}
        cases = [{"value": value, "map": name, "curve": curve} for value in sweep.values for name in sweep.maps]
        rows = [row(rng, *sweep.columns, "floor_median", **case) for case in cases]
        finish(runs, f"ablate --vary {vary}", {"vary": vary, "settings": {"vary": vary}, "rows": rows})


def turntable(rng: np.random.Generator, *searches: str) -> dict[str, Any]:
    """What real_turntable finds of 20 frames with these searches."""
    cases = [(name, search) for name in ("none", "otsu", "pix2pix") for search in searches]
    lines, frames = [], {"truth_deg": rng.uniform(0, 180, 20).tolist()}
    for name, search in cases:
        error = rng.uniform(-90, 90, 20) ** 3 / 90**2
        p50, p90 = np.percentile(np.abs(error), (50, 90))
        lines.append(row(rng, segmenter=name, search=search, yaw="refined", median_deg=p50, p90_deg=p90))
        frames[f"{name}, {search}, refined"] = {"error_deg": error.tolist()}
    gaps = [{"search": search, "other": name, "p50": [-0.1, -0.2, 0.3], "p90": [-1.0, -2.0, 0.3]}
            for name, search in cases if name != "pix2pix"]  # fmt: skip
    return {"frames": 20, "rows": lines, "failures": [], "compared": gaps, "per_frame": frames, "sheets": []}


def make_turntable(runs: Path, rng: np.random.Generator) -> None:
    finish(runs, "real_turntable", turntable(rng, "recognize", "tight crop", "fixed window"))


def make_poses(runs: Path, rng: np.random.Generator) -> None:
    names = "judge", "judge, geometry known", "own simulator (validation)"
    found = {n: {v: [row(rng, "cm", "deg") for _ in range(4)] for v in ("1", "2")} for n in names}
    rows = [row(rng, "mean_cm", "mean_deg", name=n, views=v) for n in names for v in ("1", "2")]
    finish(runs, "lean_pose", {"rows": rows, "per_frame": found})


def make_calibration(runs: Path, rng: np.random.Generator) -> None:
    names = "tilt [°]", "height [cm]", "range scale [%]", "azimuth scale [%]"
    image, template = rng.random((4, *sonar_for(20.0).shape)), np.full((4, *sonar_for(20.0).shape), 0.5)
    template[:, 200:230, 40:60] = 1.0
    arrays = {"image": image, "nominal": template, "fitted": np.roll(template, 20, axis=1)}
    report = {"rows": [row(rng, "median", number=name) for name in names], "sets": []}
    finish(runs, "self_calibration", report, before_after=arrays)


def make_catalog(runs: Path, rng: np.random.Generator) -> None:
    names, sets = ["target", "target, mirror image", "brick"], ("drawn devices", "the judge")
    rows = [row(rng, "top_1", "alike", "identified", "refused", frames_of=name) for name in sets]
    counts = {name: (rng.integers(0, 2, (3, 3)) + 3 * np.eye(3, dtype=int)).tolist() for name in sets}
    alike = [["target", "target, mirror image"]]
    finish(runs, "catalog", {"objects": names, "alike": alike, "rows": rows, "confusion": counts})


def make_tracks(runs: Path, rng: np.random.Generator) -> None:
    keys = ("rms", "bar", "median", "std", "within_1", "astray", "place")
    views = [row(rng, *keys, name=name, count=n, cases=3) for name in ("one place", "around") for n in (1, 2, 4, 8, 16)]
    real = [row(rng, "within", "median", "p90", "most", way="recognize", frames=5)]
    report = {"rows": views, "floor_deg": 0.4, "symmetric": {}, "real": real, "update_ms": {"median": 1.0, "p95": 2.0}}
    finish(runs, "track_views", report, real={name: rng.uniform(-90, 90, 5) for name in ("alone", "smoothed")})


def make_shapes(runs: Path, rng: np.random.Generator) -> None:
    sides = [row(rng, "median", frames_of="our simulator", side=side) for side in ("length", "width", "height")]
    bodies = [row(rng, "chamfer_mm", body="1", when=when) for when in ("a ball", "fitted")]
    vertices, faces = objects.sphere_arrays(0.1, rings=5, sectors=8)
    body = {f"{n}_{f}": v for n in ("first", "found", "true") for f, v in (("vertices", vertices), ("faces", faces))}
    report = {"bricks": sides, "bodies": bodies, "brick_s": 10.0, "range_bin_mm": 5.0}
    finish(runs, "shape_from_frames", report, body_0=body | {"score": rng.random(7)})


def make_dataset_bench(runs: Path, rng: np.random.Generator) -> None:
    rows = [row(rng, *bench_dataset.HEADS, format="coco", scenes=1)]
    pictures = {name: rng.integers(0, 3, (2, 16, 8), np.uint8) for name in ("image", "labels", "instances")}
    finish(runs, "bench_dataset", {"rows": rows, "memory": [], "cores": 2, "load": [0.0, 2.0]}, frames=pictures)


def make_thresholds(runs: Path, rng: np.random.Generator, preset: str = "full") -> None:
    rows = [row(rng, *fit_threshold.HEADS, segmenter="pix2pix", threshold=0.7654)]
    finish(runs, "fit_threshold", {"rows": rows}, preset=preset)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rng = tmp_path_factory.mktemp("runs"), np.random.default_rng(0)
    make_bench(folder)
    for make in (
        make_scenes,
        make_reproduction,
        make_yaws,
        make_ablations,
        make_turntable,
        make_poses,
        make_calibration,
        make_tracks,
        make_catalog,
        make_shapes,
        make_dataset_bench,
    ):
        make(folder, rng)
    return folder


# ---------------------------------------------------------------- the index


def test_every_item_has_a_script() -> None:
    names = list(index.scripts())
    assert [name for name in WANTED if name not in names] == []
    assert len([name for name in names if name.startswith("ext")]) >= OWN


def test_every_script_is_indexed_and_every_row_has_a_script(runs: Path) -> None:
    others = {
        "__init__",
        "__main__",
        "baseline",
        "docs_pages",
        "docs_scan",
        "docs_slice",
        "index",
        "matrix",
        "readme",
        "report",
        "shared",
        "solid",
    }
    others |= {"style", "ablations"}
    files = {path.stem for path in (PROJECT / "paper_figs").glob("*.py")}
    alone = set(index.scripts()) - set(ablations.SCRIPTS)
    assert files - others == alone
    assert {cells[1].strip("`") for cells in index.rows(runs)} == {f"{name}.py" for name in alone | {"ablations"}}


def test_every_picture_has_a_script_and_every_experiment_named_is_there() -> None:
    figures = PROJECT / "paper_figs"
    pictures = {path.stem for path in (figures / "drawn").glob("*.png")}
    drawings = {*docs_pages.DRAWINGS, *(path.stem for path in figures.glob("docs_*.py"))}
    assert pictures <= {*index.scripts(), *drawings}
    table = (figures / "README.md").read_text(encoding="utf-8")
    names = re.findall(r"-m experiments\.(\w+)", table)
    assert names and all((PROJECT / "experiments" / f"{name}.py").is_file() for name in names)
    assert {*re.findall(r"ablate --vary (\w+)", table)} == {*ablate.SWEEPS}


def test_drawn_slice_shows_what_a_ray_would_meet() -> None:
    """The faces that are seen, by hand: front and top of each box, and the front of the far one above the near one."""
    seen = np.concatenate(
        [docs_slice._point(piece) for piece in docs_slice._visible(*docs_slice.slice_of_boxes()[::-1])]
    )
    (near, near_x), (far, far_x) = docs_slice.BOXES
    fronts = [x - size[0] / 2 for size, x in ((near, near_x), (far, far_x))]
    height = docs_slice.HEIGHT_M
    grazing = height + (fronts[1] / (near_x + near[0] / 2)) * (near[2] - height)  # the ray over the near box's far edge
    on_far_front = seen[np.abs(seen[:, 0] - fronts[1]) < 1e-3]
    assert on_far_front[:, 1].min() == pytest.approx(grazing, abs=2e-3)  # the slice is a little off the middle
    assert on_far_front[:, 1].max() == pytest.approx(far[2], abs=2e-3)
    assert seen[np.abs(seen[:, 0] - fronts[0]) < 1e-3][:, 1].min() == pytest.approx(0.0, abs=2e-3)
    assert len(docs_slice.draw().axes) == 3


def test_drawn_axes_are_those_of_the_messages() -> None:
    """The same beam in both frames: a message's Y points to the right of the drawing, ours to the left."""
    message, ours, _ = docs_pages.files().axes
    for ax, azimuth in (
        (message, lambda y, ahead: math.atan2(-y, ahead)),
        (ours, lambda y, ahead: math.atan2(y, ahead)),
    ):
        (beam,) = ax.lines
        right, ahead = beam.get_xydata()[-1]
        y = right if ax is message else -right
        assert math.degrees(azimuth(y, ahead)) == pytest.approx(docs_pages.BEAM_DEG)


@pytest.mark.parametrize("name", docs_pages.DRAWINGS)
def test_drawings_are_on_a_page(name: str) -> None:
    assert (PROJECT / "paper_figs" / "drawn" / f"{name}.png").is_file()
    pages = [page.read_text(encoding="utf-8") for page in (PROJECT / "docs").glob("*.md")]
    assert sum(f"drawn/{name}.png" in page for page in pages) == 1
    assert docs_pages.DRAWINGS[name]().axes


@pytest.mark.parametrize("name", index.scripts())
def test_script_says_what_it_is(name: str) -> None:
    script = index.scripts()[name]
    assert script.ITEM and script.CAPTION.endswith(".") and script.EXPERIMENTS
    for experiment in script.EXPERIMENTS:
        assert (PROJECT / "experiments" / f"{experiment.split()[0]}.py").is_file()
    source = Path(inspect.getfile(script.draw)).read_text(encoding="utf-8")
    assert not re.search(r"\b(render|recognize|template_bank|refine_yaw|paper_frames)\(", source)  # it only reads


@pytest.mark.parametrize("name", index.scripts())
def test_numbers_of_the_paper(name: str, runs: Path, tmp_path: Path) -> None:
    numbers = index.numbers(index.scripts()[name], runs)
    said = [number.paper for number in numbers if number.paper is not None]
    np.testing.assert_allclose(said, PAPER.get(name, []), atol=1e-9)
    assert {number.ours for number in index.numbers(index.scripts()[name], tmp_path)} <= {None}
    if name in PAPER:
        assert all(number.ours is not None for number in numbers)


def test_training_time(runs: Path) -> None:
    ours, peer = index.numbers(index.scripts()["sec32"], runs)
    assert ours.ours == pytest.approx(30 * 6780 / (80 / 64) / 3600)
    assert peer.ours == pytest.approx(30 * 6780 / (100 / 64) / 3600)


def test_a_name_may_be_short() -> None:
    assert index.find("ext01") == "ext01_continuous_yaw"
    with pytest.raises(SonarjaxError, match="expected one of fig01"):
        index.find("fig99")


# ---------------------------------------------------------------- drawing


@pytest.mark.parametrize("name", index.scripts())
def test_item_draws(name: str, runs: Path) -> None:
    file = io.BytesIO()
    with rc_context(style.RC):
        figure = index.drawn(name, runs)
        figure.savefig(file, format="png", dpi=50)
    pixels = imread(io.BytesIO(file.getvalue()))
    assert pixels.std() > 0
    assert figure.get_figwidth() in (style.ONE_COLUMN, style.TWO_COLUMNS)
    assert pixels.shape[1] == round(50 * figure.get_figwidth())
    assert not [text for text in figure.findobj(match=lambda artist: artist.get_gid() == "smoke")]
    sizes = [text.get_fontsize() for text in figure.findobj(match=lambda a: hasattr(a, "get_fontsize"))]
    assert min(sizes) >= 8


def test_files_have_the_size_of_print(runs: Path, tmp_path: Path) -> None:
    assert main(["tab04", "--runs", str(runs), "--out", str(tmp_path)]) == 0
    pixels = imread(tmp_path / "tab04.png")
    assert pixels.shape[1] == round(style.TWO_COLUMNS * style.DPI)
    assert pixels.std() > 0
    assert (tmp_path / "tab04.pdf").read_bytes().startswith(b"%PDF")


def test_a_short_run_is_marked(tmp_path: Path, rng: np.random.Generator) -> None:
    make_reproduction(tmp_path, rng, preset="smoke")
    with rc_context(style.RC):
        figure = index.drawn("tab04", tmp_path)
    assert [text.get_text() for text in figure.texts] == [style.SMOKE]
    assert all(style.SMOKE in cells[-1] for cells in index.rows(tmp_path) if "tab0" in cells[1])


def test_a_short_run_is_marked_in_the_page(tmp_path: Path) -> None:
    rows = [row(np.random.default_rng(0), *ablate.RECOGNIZED, value=1.0, map="otsu")]
    finish(tmp_path, SEVERITY, {"settings": {"vary": "severity"}, "vary": "severity", "rows": rows}, preset="smoke")
    assert report.page(tmp_path).html.count(report.SMOKE) >= 2


def test_a_missing_run_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fig08", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err.splitlines()
    wanted = "no finished run; `python -m experiments.reproduce_paper` makes one"
    assert said == [f"paper_figs: {tmp_path / 'reproduce_paper'}: {wanted}"]
    assert main(["--all", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 0
    assert "fig08: not run: python -m experiments.reproduce_paper" in capsys.readouterr().out


def test_an_item_that_cannot_be_drawn_costs_no_other_and_no_report(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    make_bench(tmp_path)
    finish(tmp_path, SEVERITY, {"settings": {"vary": "severity"}, "rows": [{"value": 1.0}]})
    out, page = tmp_path / "out", tmp_path / "new" / "report.html"
    assert main(["--all", "--report", str(page), "--runs", str(tmp_path), "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert f"run python -m experiments.{SEVERITY} again" in said.err and (out / "sec32.png").exists() and page.exists()


def test_an_output_folder_that_is_a_file_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_bench(tmp_path)
    (tmp_path / "file").touch()
    for words in (["sec32", "--out", str(tmp_path / "file")], ["--report", str(tmp_path / "file" / "r.html")]):
        assert main([*words, "--runs", str(tmp_path)]) == 1
        assert "cannot be used as a folder for output" in capsys.readouterr().err


def test_the_index_keeps_what_has_no_run(runs: Path, tmp_path: Path) -> None:
    full = index.text(runs)
    assert index.text(tmp_path, full) == full
    make_bench(tmp_path)
    again = index.text(tmp_path, full)
    changed = [line for line in again.splitlines() if line not in full.splitlines()]
    assert len(again.splitlines()) == len(full.splitlines()) and all("bench_train" in line for line in changed)


def test_a_run_of_other_code_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finish(tmp_path, SEVERITY, {"settings": {"vary": "severity"}, "rows": [{"value": 1.0}]})
    assert main(["ext06", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 1
    assert f"run python -m experiments.{SEVERITY} again" in capsys.readouterr().err
    (tmp_path / "ablate" / "made-up-severity-s0" / "results.json").write_text("[]", encoding="utf-8")
    assert main(["ext06", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert f"remove it and run python -m experiments.{SEVERITY} again" in said


def test_real_frames_show_as_numbers_alone(runs: Path) -> None:
    """The frames are not the project's to publish: no picture, and each point is an error of the run."""
    figure = index.drawn("ext12_real_turntable", runs)
    assert figure.findobj(AxesImage) == []
    frames = load(runs, "real_turntable").report["per_frame"]
    shares, over_yaw = figure.axes
    color = style.look("otsu")["color"]
    solid, dashed = (
        next(line for line in shares.lines if (line.get_color(), line.get_linestyle()) == (color, way))
        for way in ("-", "--")
    )
    for line, search in ((solid, "recognize"), (dashed, "fixed window")):
        sizes = np.abs(frames[f"otsu, {search}, refined"]["error_deg"])
        at = np.searchsorted(line.get_xdata(), np.percentile(sizes, 50)) - 1
        assert line.get_ydata()[at] == pytest.approx(0.5)
    (points,) = (line for line in over_yaw.lines if line.get_label() == "pix2pix")
    np.testing.assert_allclose(points.get_xdata(), frames["truth_deg"])
    np.testing.assert_allclose(points.get_ydata(), frames["pix2pix, recognize, refined"]["error_deg"])


def test_real_frames_index_rows(runs: Path) -> None:
    lines = [row for row in load(runs, "real_turntable").report["rows"] if row["search"] == "recognize"]
    wanted = {(row["segmenter"], row[key]) for row in lines for key in ("median_deg", "p90_deg")}
    numbers = index.numbers(index.scripts()["ext12_real_turntable"], runs)
    assert {(number.what.split(", ")[0], number.ours) for number in numbers} == wanted
    assert len(numbers) == 6


@pytest.mark.parametrize("left", [[], ["none, recognize"], ["otsu, fixed window"], ["pix2pix, tight crop"]])
def test_real_frames_with_parts_left_out(tmp_path: Path, rng: np.random.Generator, left: list[str]) -> None:
    results = turntable(rng, "recognize", "tight crop", "fixed window")
    names = [f"{name}, refined" for name in left]
    results["per_frame"] = {key: results["per_frame"][key] for key in ["truth_deg", *names]}
    results["rows"] = [row for row in results["rows"] if f"{row['segmenter']}, {row['search']}" in left]
    del results["compared"]  # runs of earlier code have none
    finish(tmp_path, "real_turntable", results)
    assert main(["ext12", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 0
    ours = [number.ours for number in index.numbers(index.scripts()["ext12_real_turntable"], tmp_path)]
    assert len(ours) - ours.count(None) == 2 * (left == ["none, recognize"])


# ---------------------------------------------------------------- the page and the tables


class Sources(HTMLParser):
    """What a page loads, and whether its elements are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loaded += [value or "" for key, value in attrs if key in ("src", "srcset", "data")]
        self.loaded += [value or "" for key, value in attrs if key == "href" and not (value or "").startswith("#")]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_page_of_some_runs_loads_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    make_bench(tmp_path)
    make_ablations(tmp_path, rng)
    page = report.page(tmp_path).html
    sources = Sources()
    sources.feed(page)
    assert sources.open == []
    assert sources.loaded and all(source.startswith("data:image/png;base64,") for source in sources.loaded)
    assert "http" not in page and "@import" not in page and "url(" not in page
    assert 'id="sec32"' in page and 'id="fig08"' not in page
    assert "python -m experiments.reproduce_paper" in page
    assert "0123456789" in page and "2020-02-02" in page


def test_page_has_the_tables(tmp_path: Path, rng: np.random.Generator) -> None:
    make_reproduction(tmp_path, rng)
    run = load(tmp_path, "reproduce_paper")
    text = report.numbers(run)
    for value in (*np.diag(paper.TABLE_3_TARGET), *np.diag(paper.TABLE_4)):
        assert f"{value:.4f}" in text
    table = run.report["tables"]["tab03"]
    below = np.array(table["target"])[np.array(table["target_shown"]) == 0]
    assert len(below) and all(f'<span class="under">{value:.4f}</span>' in text for value in below)


def test_page_has_every_experiment_that_has_run(tmp_path: Path, rng: np.random.Generator) -> None:
    make_thresholds(tmp_path, rng, preset="smoke")  # no figure is drawn from it
    make_turntable(tmp_path, rng)
    make_bench(tmp_path)
    page = report.page(tmp_path).html
    tables = re.findall(r"<details><summary>(\w+)", page)
    assert tables == ["bench_train", "real_turntable", "fit_threshold", "settings"]
    assert re.findall(r'<tr><td>(\w+)</td><td>(\w+)</td><td class="n">0</td>', page) == [
        ("bench_train", "full"), ("real_turntable", "full"), ("fit_threshold", "smoke")
    ]  # fmt: skip
    assert f"<summary>fit_threshold{report.SMOKE}</summary>" in page and page.count(report.SMOKE) == 1
    assert '<td class="n">0.765</td>' in page and "-0.10 (-0.20 to +0.30)" in page


def test_page_of_runs_alone_that_no_figure_shows(tmp_path: Path, rng: np.random.Generator) -> None:
    make_thresholds(tmp_path, rng)
    page = report.page(tmp_path).html
    assert "<summary>fit_threshold</summary>" in page and "<tr><td>fit_threshold</td>" in page


def test_what_other_code_left_costs_its_own_part_of_the_page(tmp_path: Path, rng: np.random.Generator) -> None:
    make_thresholds(tmp_path, rng)
    finish(tmp_path, "no_longer_there", {"rows": []})
    finish(tmp_path, "real_turntable", {"rows": [], "per_frame": {"truth_deg": "<none>"}})
    finish(tmp_path, "reproduce_paper", {"rows": 1})
    finish(tmp_path, SEVERITY, {"settings": {"vary": "severity"}, "rows": [1.0, 2.0]})
    finish(tmp_path, "gradient_check", {"git": None, "scenes": {}})
    for name, text in (("calibrate_sensor", "[1]"), ("bench_all", '{"rows": ['), ("yaw_basin", "{}")):
        (tmp_path / name / "a-s0").mkdir(parents=True)
        (tmp_path / name / "a-s0" / "results.json").write_text(text, encoding="utf-8")
    (tmp_path / "bare" / "b-s0").mkdir(parents=True)
    (tmp_path / "bare" / "b-s0" / "results.json").write_text('{"preset": "full", "seed": 0}', encoding="utf-8")
    page, table = report.page(tmp_path)
    sources = Sources()
    sources.feed(page)
    assert sources.open == [] and "<none>" not in page
    assert '<td class="n">0.765</td>' in page  # what this code made is shown
    for name in ("bare", "no_longer_there", "real_turntable", "reproduce_paper", SEVERITY, "gradient_check"):
        assert re.search(rf"<summary>{name}</summary><p>Made by other code, [^<]+</p></details>", page)
        assert f"<tr><td>{name}</td><td>full</td>" in page
    assert not re.search("<summary>(calibrate_sensor|bench_all|yaw_basin)<", page)  # no report at all
    assert table is not None and table.startswith("Made by other code")


def test_the_terminal_ends_with_the_path_alone_without_the_main_run(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    make_thresholds(tmp_path, rng)
    path = tmp_path / "report.html"
    assert main(["--report", str(path), "--runs", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{path}\n"


def test_make_reproduce_ends_with_the_report() -> None:
    recipe = re.search(
        r"^reproduce:.*\n((?:\t.*\n)+)", (PROJECT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert recipe is not None
    last = recipe[1].splitlines()[-1]
    assert "-m paper_figs --all" in last and "--report" in last


def test_no_run_at_all_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--report", str(tmp_path / "report.html"), "--runs", str(tmp_path)]) == 1
    assert "no finished run" in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()


MARKED = "before\n\n<!-- {0}:begin -->\nof last year\n<!-- {0}:end -->\n\n<!-- {1}:begin -->\n<!-- {1}:end -->\nafter\n"


def test_readme_gives_the_mean_of_all_seeds_and_the_largest_deviation() -> None:
    assert readme.mean_and_spread([0.5, 0.6, 0.8]) == "0.633 ± 0.167"
    assert readme.mean_and_spread([0.5, 0.5002]) == 0.5


def test_tables_keep_an_empty_line_around_them() -> None:
    assert readme.spaced("a\n| b |\n| c |\n\n| d |\ne") == "a\n\n| b |\n| c |\n\n| d |\n\ne"


def test_readme_is_filled_between_its_markers(runs: Path, tmp_path: Path) -> None:
    path = tmp_path / "README.md"
    path.write_text(MARKED.format("reproduce_paper", "yaw_basin"), encoding="utf-8")
    readme.update((path,), runs, tmp_path / "kept")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n") and "of last year" not in text
    assert "| pix2pix |" in text and "seed 0; 2020-02-02, commit 0123456789" in text
    assert not re.search(r"^[^|\n].*\n\|", text, re.MULTILINE)  # an empty line before each table
    readme.update((path,), tmp_path / "no runs", tmp_path / "kept")  # from what is kept
    assert path.read_text(encoding="utf-8") == text
    assert readme.with_blocks(text.replace("| pix2pix |", "| pix3pix |"), path, tmp_path / "kept") == text


def test_a_page_with_one_marker_is_left_alone(runs: Path, tmp_path: Path) -> None:
    path, broken = tmp_path / "README.md", "<!-- reproduce_paper:end -->\n<!-- reproduce_paper:begin -->"
    path.write_text(broken, encoding="utf-8")
    with pytest.raises(SonarjaxError, match="expected one line <!-- reproduce_paper:begin -->"):
        readme.update((path,), runs, tmp_path / "kept")
    assert path.read_text(encoding="utf-8") == broken


def test_before_and_after_stand_side_by_side(tmp_path: Path) -> None:
    numbers = {"rows": [{"rms": 0.25}, {"rms": 0.5}, {"rms": 1.0}]}
    compared = {"refine_accuracy": baseline.COMPARED["refine_accuracy"]}
    (tmp_path / "baseline_f99308b.json").write_text(json.dumps({"refine_accuracy": numbers}), encoding="utf-8")
    numbers["rows"][1]["rms"] = 0.75
    (tmp_path / "refine_accuracy.json").write_text(json.dumps([numbers]), encoding="utf-8")
    table = baseline.table(tmp_path, compared)
    assert "| 0.250 | 0.250 |" in table and "| 0.500 | 0.750 |" in table


def test_readme_takes_full_runs_only(tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(SonarjaxError, match="expected the results of"):
        readme.block("fit_threshold", tmp_path / "kept")
    make_thresholds(tmp_path, rng, preset="smoke")
    with pytest.raises(SonarjaxError, match="preset smoke"):
        readme.keep("fit_threshold", tmp_path, tmp_path / "kept")


@pytest.mark.parametrize("preset", ["full", "smoke"])
def test_the_terminal_ends_with_the_table_and_the_path(
    tmp_path: Path, rng: np.random.Generator, preset: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    make_reproduction(tmp_path, rng, preset)
    made = []
    own_table = report.own_table
    monkeypatch.setattr(report, "own_table", lambda name, found: made.append(name) or own_table(name, found))
    path = tmp_path / "new" / "report.html"
    shown = "tab03"  # alone: drawing takes its time
    few = {name: script for name, script in index.scripts().items() if name == shown}
    monkeypatch.setattr(index, "scripts", lambda: few)
    assert main(["--all", "--report", str(path), "--runs", str(tmp_path), "--out", str(tmp_path)]) == 0
    table = own_table("reproduce_paper", load(tmp_path, "reproduce_paper").report)
    mark = f"\n{style.SMOKE}\n" if preset == "smoke" else ""
    said = capsys.readouterr().out
    assert said == f"{tmp_path / shown}.png\n\n{table}\n{mark}\n{path}\n"
    assert "| item | what | paper | ours | note |" in said
    assert made == ["reproduce_paper"]  # once, for the page and the terminal
    assert path.is_file()


def test_readme_s_command_makes_all_seeds_though_several_commands_did() -> None:
    made = {"command": "python -m experiments.x --step-deg 30 --seeds 0 1", "date": "2020-02-02", "git": "0123456789"}
    alone = "`python -m experiments.x --step-deg 30`, seed 0; 2020-02-02, commit 0123456789"
    assert readme.origin([made | {"seed": 0}]) == alone
    said = readme.origin([made | {"seed": seed} for seed in (0, 1, 2)])
    assert said.startswith("`python -m experiments.x --step-deg 30 --seeds 0 1 2`, seeds 0, 1, 2: mean ± largest dev")


def test_fig_5_shows_port_on_the_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames have starboard first: the last beam is the first column of the picture."""
    image = np.zeros((1, 128, 128), np.float32)
    image[0, :, 100:] = 1.0
    pairs = {"image": image, "labels": image.astype(int)}
    monkeypatch.setattr(Run, "arrays", lambda self, name: pairs)
    figure = fig05.draw(Run(Path(), {}))
    for ax in figure.axes:
        picture = ax.images[0]
        left, right = np.asarray(picture.get_array())[:, [0, -1]].T
        assert (left == 1).all() and (right < 1).all() and ax.get_xlim()[0] < ax.get_xlim()[1]
