from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from scenes.networks import write_classifier
from typer.testing import CliRunner

from ltm_core.base.errors import ModelError, RecordingError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.fuel.label_errors import known_errors
from ltm_core.label_heads.head_fit import PhotoSamples, by_area, fit_head, sites_of
from ltm_core.label_heads.head_trial import teach_head
from ltm_core.label_heads.labelled_frames import Frame, read_frames
from ltm_core.vision.label_head import find_label_head, read_label_head
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.decoder_maps import with_decoder_maps
from ltm_ros.cli.main import cli


def _samples(features: list[list[float]], labels: list[int], shares: list[float]) -> PhotoSamples:
    values = np.array(features)
    return PhotoSamples("a", np.array(labels, np.uint8), np.zeros((len(labels), 2)), values, np.array(shares))


def _scores(head: tuple[Float64Array, Float64Array], samples: PhotoSamples) -> Float64Array:
    return samples.scores + samples.features @ head[0] + head[1]


def test_a_head_tells_apart_what_its_map_does() -> None:
    samples = _samples([[1.0, 9.0], [1.2, 9.0], [-1.0, 9.0], [-1.1, 9.0]], [0, 0, 1, 1], [0.3, 0.3])
    head = fit_head([samples], {"last": 1, "s2": 1})
    assert head[0][0, 0] > 0 > head[0][0, 1]
    np.testing.assert_allclose(head[0][:, 0], -head[0][:, 1], atol=1e-4)
    np.testing.assert_allclose(head[0][1], 0.0, atol=1e-4)  # of a map that is the same everywhere
    np.testing.assert_array_equal(_scores(head, samples).argmax(axis=1), [0, 0, 1, 1])


def _striped(magenta_right: bool, seed: int) -> tuple[UInt8Array, UInt8Array]:
    """Sky over two halves: magenta, which a person calls built, and brown earth."""
    rng = np.random.default_rng(seed)
    photo, labels = np.empty((176, 320, 3), np.uint8), np.full((176, 320), UNLABELLED, np.uint8)
    photo[:60], photo[60:, :160], photo[60:, 160:] = (110, 160, 230), (200, 30, 200), (120, 90, 60)
    if not magenta_right:
        photo[60:] = photo[60:, ::-1]
    built = (photo[..., 1] == 30) & (photo[..., 0] == 200)
    labels[:50], labels[70:][~built[70:]], labels[70:][built[70:]] = Label.SKY, Label.BARE, Label.BUILT
    return np.clip(photo + rng.normal(0, 12, photo.shape), 0, 255).astype(np.uint8), labels


def _write_photos(folder: Path, spoiled: bool = False) -> Path:
    folder.mkdir(parents=True)
    for place, site in enumerate(("north", "south", "west")):
        photo, labels = _striped(place % 2 == 0, place)
        if spoiled:  # each site calls the same thing something else
            labels[labels != UNLABELLED] = (labels[labels != UNLABELLED] + 1 + place * 2) % 7
        cv2.imwrite(str(folder / f"{site}_1.png"), photo[..., ::-1])
        cv2.imwrite(str(folder / f"{site}_1_labels.png"), labels)
    return folder


@pytest.mark.slow
def test_the_command_installs_a_head_that_is_better_where_it_was_not_taught(tmp_path: Path) -> None:
    photos, out = _write_photos(tmp_path / "photos"), tmp_path / "heads" / "pink.yaml"
    command = ["train", "head", str(photos), "--out", str(out)]
    result = CliRunner().invoke(cli, command, env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    manifest = NetworkManifest.find("landscape_lite0")
    head, content = read_label_head(out, manifest)
    assert out.stat().st_size < 20_000
    assert content.calibration is not None
    assert content.calibration.measured_on == "3 photos of 3 sites, held out by site"
    photo, labels = _striped(True, 9)
    found = Segmenter(manifest, head=head).segment(photo).labels
    assert (found == labels)[labels != UNLABELLED].mean() > 0.9
    assert (Segmenter.open().segment(photo).labels == Label.BUILT)[labels == Label.BUILT].mean() < 0.5


def test_the_near_head_fits_the_network_that_ships() -> None:
    manifest = NetworkManifest.find("landscape_lite0")
    file = find_label_head("near", manifest)
    assert file is not None
    read_label_head(file, manifest)
    assert known_errors("landscape_lite0", "near").state == "measured on photos"


@pytest.mark.slow
def test_a_head_that_is_worse_is_not_installed(tmp_path: Path) -> None:
    photos, out = _write_photos(tmp_path / "photos", spoiled=True), tmp_path / "heads" / "noise.yaml"
    result = CliRunner().invoke(cli, ["train", "head", str(photos), "--out", str(out)])
    assert isinstance(result.exception, ModelError)
    assert "not installed" in str(result.exception) or "no class" in str(result.exception)
    assert not list(out.parent.glob("*")) if out.parent.is_dir() else True


def test_the_site_of_a_photo_is_in_its_name_or_in_a_table(tmp_path: Path) -> None:
    nothing = np.zeros((2, 3), np.uint8)
    frames = [Frame(np.zeros((2, 3, 3), np.uint8), nothing, tmp_path / n) for n in ("peak_n_1.jpg", "b.jpg", "c_1.jpg")]
    assert sites_of(frames) == ["peak", "b", "c"]
    (tmp_path / "sites.csv").write_text("image,site\nb.jpg,peak\n")
    assert sites_of(frames) == ["peak", "peak", "c"]
    (tmp_path / "sites.csv").write_text("photo,place\nb.jpg,peak\n")
    with pytest.raises(RecordingError, match="expected image, site"):
        sites_of(frames)


def test_a_network_without_the_decoder_s_convolutions_has_no_maps(tmp_path: Path) -> None:
    write_classifier(tmp_path)
    with pytest.raises(ModelError, match="no convolution of network"):
        with_decoder_maps(onnx.load(tmp_path / "colors.onnx"))
    model, channels = with_decoder_maps(onnx.load(NetworkManifest.find("landscape_lite0").model_file()))
    assert channels == {"last": 32, "s2": 64, "s1": 64}
    assert [output.name for output in model.graph.output].count("last") == 1


def _one_view(folder: Path) -> tuple[Path, UInt8Array]:
    """A photo with two strokes of each of three classes, and what it shows in truth."""
    photo, truth = _striped(True, 5)
    strokes = np.full_like(truth, UNLABELLED)
    for rows, cols in ((slice(10, 40), slice(20, 80)), (slice(10, 40), slice(200, 260))):
        strokes[rows, cols] = Label.SKY
    for rows in (slice(80, 105), slice(130, 160)):
        strokes[rows, 20:80], strokes[rows, 200:260] = Label.BUILT, Label.BARE
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "mast_1.png"), photo[..., ::-1])
    cv2.imwrite(str(folder / "mast_1_labels.png"), strokes)
    return folder, truth


def test_areas_of_one_photo_are_in_folds_of_all_classes(tmp_path: Path) -> None:
    folder, _ = _one_view(tmp_path / "view")
    (frame,) = read_frames(folder, 7)
    parts, names = by_area([frame])
    assert names == [f"areas {k}" for k in (1, 2, 3, 4)]
    for label in (Label.SKY, Label.BARE, Label.BUILT):
        assert sum(bool((part.labels == label).any()) for part in parts) >= 2
    assert (np.sum([part.labels != UNLABELLED for part in parts], axis=0) == (frame.labels != UNLABELLED)).all()
    for part in parts:
        np.testing.assert_array_equal(part.image, frame.image)
        known = part.labels != UNLABELLED
        np.testing.assert_array_equal(part.labels[known], frame.labels[known])
    wide = np.full_like(frame.labels, UNLABELLED)
    wide[:20] = Label.SKY  # one area across the picture still teaches and judges
    assert len(by_area([Frame(frame.image, wide, frame.path)])[0]) == 4
    small = np.full_like(frame.labels, UNLABELLED)
    small[4:20, 4:20] = Label.SKY
    with pytest.raises(ModelError, match="in two areas"):
        teach_head(Segmenter.open(), [Frame(frame.image, small, frame.path)], "x", "", one_view=True)


@pytest.mark.slow
def test_strokes_of_one_view_make_a_head_for_that_view_alone(tmp_path: Path) -> None:
    """It labels the view, and is judged by areas that did not teach it."""
    folder, truth = _one_view(tmp_path / "view")
    out = tmp_path / "heads" / "mast.yaml"
    result = CliRunner().invoke(cli, ["train", "head", str(folder), "--out", str(out), "--one-view"])
    assert result.exit_code == 0, result.output
    manifest = NetworkManifest.find("landscape_lite0")
    head, content = read_label_head(out, manifest)
    assert content.one_view
    assert content.calibration is not None
    assert content.calibration.measured_on == "1 photos of 1 sites, held out by area, all of one view"
    assert content.calibration.photographs == 1
    photo, _ = _striped(True, 11)
    found = Segmenter(manifest, head=head).segment(photo).labels
    assert (found == truth)[truth != UNLABELLED].mean() > 0.9


def test_what_cannot_teach_is_told(tmp_path: Path) -> None:
    frames = read_frames(_write_photos(tmp_path / "photos"), 7)
    with pytest.raises(ModelError, match="one photo"):
        teach_head(Segmenter.open(), frames[:1], "x", "")
    with pytest.raises(ModelError, match="no decoder maps"):
        teach_head(Segmenter.open(write_classifier(tmp_path)), frames, "x", "")
    with pytest.raises(ModelError, match="classes are the labels"):
        teach_head(Segmenter.open(write_classifier(tmp_path, maps=True)), frames, "x", "")
