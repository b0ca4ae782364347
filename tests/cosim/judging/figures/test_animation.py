"""Animations: which plants have a picture, what is drawn, and that it follows the run; how they look was judged by eye."""

import io
import re
import warnings

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.image import imread
from PIL import Image

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.errors import ModelError, ResultFileError
from bayesftc.cosim.judging.figures import panels
from bayesftc.cosim.judging.figures.notebook import NotebookFigure, _Differences, _Pictures
from bayesftc.cosim.judging.figures.pictures import PICTURES

MODEL = {"process_covariance": 0.001, "sensor_covariance": 1.0, "dt": 0.02}


@pytest.fixture(autouse=True)
def closed():
    yield
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # matplotlib's, of an animation that is never shown
        pyplot.close("all")


def car(**settings):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], **MODEL)
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=2, std=1.0),
        reference=20.0,
        **settings,
    )


def alone(name, **parameters):
    """A plant without a controller, with a constant first input."""
    diagram = cosim.Diagram(dt=0.02)
    plant = diagram.add(cosim.FMU(fmus.path(name), parameters=parameters), "plant")
    push = diagram.add(cosim.Constant(1.0), "push")
    diagram.connect(push["y"], plant[plant.block.inputs[0].name])
    return diagram.simulate(1.0, engine="interpreted")


def texts(animation):
    return " ".join(
        [text.get_text() for axis in animation.figure.axes for text in axis.texts]
        + [axis.get_title() for axis in animation.figure.axes]
    )


def keep(animation):
    """Count an animation as shown, else matplotlib warns when it is deleted."""
    animation._draw_was_started = True
    return animation


def show(animation, k):
    animation._func(k)


def test_every_shipped_plant_has_a_picture_with_its_outputs_and_lengths():
    assert set(PICTURES) == set(fmus.names()), "each shipped plant has a picture in cosim/judging/figures/pictures.py"
    for name, picture in PICTURES.items():
        plant = cosim.FMU(fmus.path(name))
        assert {*picture.variables, *picture.sized} <= {port.name for port in plant.outputs}
        assert dict(picture.lengths) == {length: plant.start_value(length) for length in picture.lengths}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", sorted(PICTURES))
def test_a_picture_follows_the_plant(name):
    parameters = {"CruiseControl": {"v0": 5.0}, "CartPendulum": {"angle_0": 0.3}, "TwoLinkArm": {"q1_0": 0.0}}.get(
        name, {}
    )
    animation = keep(alone(name, **parameters).animate(frames=5))
    scene = animation.figure.axes[0]
    states = []
    for k in (0, 4):
        show(animation, k)
        states.append([line.get_xydata().copy() for line in scene.lines])
    assert any(not np.array_equal(a, b) for a, b in zip(*states, strict=True))
    assert all(np.isfinite(points).all() for points in states[1])
    assert scene.get_title() == "t = 1.00 s"


def test_the_arm_has_its_own_lengths():
    run = alone("TwoLinkArm", L1=0.5, q1_0=0.0)
    assert run.metadata["plants"] == {"plant": {"model": "TwoLinkArm", "parameters": {"L1": 0.5, "q1_0": 0.0}}}
    animation = keep(run.animate(frames=3))
    show(animation, 0)
    links = max(animation.figure.axes[0].lines, key=lambda line: line.get_linewidth()).get_xydata()
    assert links == pytest.approx(np.array([[0.0, 0.0], [0.5, 0.0], [1.5111, 0.0]]))


def test_the_reading_of_a_faulty_sensor_is_drawn_and_grows_pale():
    run = car(faults=[cosim.Injection(sensor=0, start=1.0, magnitude=8.0)]).simulate(2.0, seed=1)
    animation = keep(run.animate(frames=21))
    scales = animation.figure.axes[1]
    marks = {line.get_label(): line for line in scales.lines}
    assert {"true value", "belief", "reference", "sensor 0", "sensor 1"} <= set(marks)
    show(animation, 0)
    assert marks["sensor 0"].get_alpha() == marks["sensor 1"].get_alpha() == 1.0
    assert "alarm" not in texts(animation)
    show(animation, 20)
    assert marks["sensor 0"].get_alpha() < 0.5 < marks["sensor 1"].get_alpha()
    assert "alarm: sensor 0" in texts(animation)
    place = {name: float(marks[name].get_xdata()[0]) for name in marks if not name.startswith("_")}
    assert abs(place["belief"] - place["true value"]) < abs(place["sensor 0"] - place["true value"])


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("magnitude", "beyond"), [(8.0, ""), (1e6, "sensor 0: 1e+06"), (-1e6, "sensor 0: -1e+06")])
def test_a_faulty_reading_is_on_its_scale_or_an_arrow_with_its_value(magnitude, beyond):
    """A mark that merely stopped at the end of the scale stood beside those of healthy sensors."""
    run = car(faults=[cosim.Bias(sensor=0, start=1.0, magnitude=magnitude)]).simulate(2.0, seed=1, engine="interpreted")
    animation = keep(run.animate(frames=21))
    scales, signals = animation.figure.axes[1:3]
    (mark,) = (line for line in scales.lines if line.get_label() == "sensor 0")
    usual = mark.get_marker()
    show(animation, 20)
    assert mark.get_marker() == (">" if magnitude > 8.0 else "<" if magnitude < 8.0 else usual)
    assert (0.0 < mark.get_xdata()[0] < 1.0) == (not beyond)
    assert beyond in texts(animation)
    low, high = signals.get_ylim()
    assert high - low < 30.0
    assert bool(beyond) == ("cut off" in texts(animation))
    show(animation, 0)
    assert mark.get_marker() == usual
    assert "sensor 0: 1e+06" not in texts(animation)


def test_the_servo_of_a_faulty_sensor_is_drawn_beside_the_true_one():
    plant = cosim.FMU(fmus.path("PositionServo"))
    controller = controllers.design(plant, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01)
    loop = cosim.closed_loop(
        plant, controller, control="voltage", measured="angle", sensors=cosim.Sensors(2, 0.01), reference=0.0,
        faults=[cosim.Bias(sensor=1, start=0.5, magnitude=1.0)],
    )  # fmt: skip
    animation = keep(loop.simulate(1.0, seed=1).animate(frames=11))
    show(animation, 10)
    pointers = {line.get_color(): line.get_xydata()[1] for line in animation.figure.axes[0].lines[:8:2]}
    assert len(pointers) == 4  # two sensors, the true shaft, the belief
    first, second, true, belief = pointers.values()
    assert np.hypot(*(belief - true)) < 0.1
    assert np.hypot(*(first - true)) < 0.1
    assert np.hypot(*(second - true)) > 0.8


def test_other_plants_have_scales(tmp_path):
    diagram = cosim.Diagram(dt=0.1)
    wave, gain = diagram.add(cosim.Sine(amplitude=1.0, period=1.0), "wave"), diagram.add(cosim.Gain(2.0), "gain")
    diagram.connect(wave["y"], gain["u"])
    run = diagram.simulate(1.0, engine="interpreted")
    animation = keep(run.animate(frames=4))
    assert {"wave.y", "gain.y"} <= {text.get_text() for text in animation.figure.axes[0].texts}
    assert len(animation.figure.axes) == 2


def test_plants_without_their_outputs_have_scales():
    run = car().simulate(0.2, seed=1, engine="interpreted", record=["controller.*"])
    animation = keep(run.animate(frames=3))
    assert len(animation.figure.axes) == 3
    assert "v (m/s)" in texts(animation)


@pytest.mark.slow
def test_a_saved_run_is_animated_alike(tmp_path):
    run = car().simulate(0.2, seed=1, engine="interpreted")
    loaded = cosim.Result.load(run.save(tmp_path / "run.npz"))
    assert [len(keep(each.animate(frames=3)).figure.axes) for each in (run, loaded)] == [4, 4]


@pytest.mark.slow
def test_a_notebook_shows_a_player_and_a_file_can_be_written(tmp_path):
    run = car().simulate(0.2, seed=1, engine="interpreted")
    animation = run.animate(frames=2, speed=0.5)
    assert animation._interval == pytest.approx(200.0)
    page = animation._repr_html_()
    assert "<script" in page
    assert not re.search(r"<(link|script)[^>]*http", page)  # it is complete without a network
    assert "fa-" not in page
    assert re.search(r'<img [^>]*alt="Animation: ', page)
    assert re.search(r'<input [^>]*type="range"[^>]*aria-label="', page)
    assert animation.to_jshtml() == page
    animation.save(tmp_path / "run.gif")
    assert (tmp_path / "run.gif").read_bytes().startswith(b"GIF8")


@pytest.mark.slow
@pytest.mark.parametrize("notebook", [False, True])
def test_legends_and_names_of_faults_have_room(monkeypatch, notebook):
    """The figure of a notebook has no canvas of pyplot, and needs the same layout."""
    monkeypatch.setattr(panels, "_in_notebook", lambda: notebook)
    freeze = cosim.Freeze(sensor=0, start=1.0)
    animation = keep(car(faults=[freeze]).simulate(4.0, seed=1, engine="interpreted").animate(frames=3))
    figure = animation.figure
    assert isinstance(figure, NotebookFigure) == notebook
    figure.draw_without_rendering()
    legends = [axis.get_legend().get_window_extent() for axis in figure.axes if axis.get_legend()]
    assert len(legends) == 3
    for box in legends:
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    (name,) = [text for axis in figure.axes for text in axis.texts if text.get_text() == "sensor 0: freeze"]
    highest = max(name.get_window_extent().y1, name.axes.bbox.y1)
    assert highest <= legends[0].y0


def test_a_gif_and_a_page_need_no_ffmpeg_and_a_film_says_so(tmp_path, monkeypatch, caplog):
    animation = keep(car().simulate(0.2, seed=1, engine="interpreted").animate(frames=3))
    monkeypatch.setattr("bayesftc.cosim.base.announcing.PATIENCE", 0.0)
    monkeypatch.setenv("PATH", str(tmp_path))  # without any program
    for name, beginning in {"run.gif": b"GIF8", "run.html": b"\n<link"}.items():
        caplog.clear()
        animation.save(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(beginning)
        assert caplog.messages == [f"Drawing {tmp_path / name}, for some seconds."]  # none of a writer that is missing
    with pytest.raises(ResultFileError, match=r"ffmpeg.*Save a GIF, film\.gif, or install ffmpeg"):
        animation.save(tmp_path / "film.mp4")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("name", "longest"), [("run.gif", 655.35), ("run.png", 65.535)])
def test_pictures_that_last_too_long_are_refused_before_they_are_drawn(tmp_path, name, longest):
    run = car().simulate(0.2, seed=1, engine="interpreted")
    animation = keep(run.animate(frames=2, speed=0.1 / (longest + 0.01)))
    with pytest.raises(ResultFileError, match=r"speed= at least 1.01 times as large, or more frames="):
        animation.save(tmp_path / name)
    assert not (tmp_path / name).exists()
    keep(run.animate(frames=2, speed=0.1 / (longest - 0.1))).save(tmp_path / name)


def test_the_text_of_an_animation_says_how_to_keep_it():
    animation = keep(car().simulate(0.2, seed=1, engine="interpreted").animate(frames=3, speed=1e-4))
    assert (
        repr(animation) == "<NotebookAnimation of 3 pictures in 2000 s; animation.save('run.gif') writes it to a file>"
    )


def test_a_missing_sample_is_not_drawn():
    run = car(faults=[cosim.Dropout(sensor=0, start=0.1)]).simulate(0.2, seed=1, engine="interpreted")
    animation = keep(run.animate(frames=3))
    marks = {line.get_label(): line for line in animation.figure.axes[1].lines}
    show(animation, 2)
    assert np.isnan(marks["sensor 0"].get_xdata()).all()
    assert np.isfinite(marks["sensor 1"].get_xdata()).all()


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frames": 1}, "frames=1; give a whole number of at least 2"),
        ({"frames": 2.5}, "frames=2.5; give a whole number"),
        ({"frames": True}, "frames=True"),
        ({"speed": 0.0}, "speed=0.0; give a positive number"),
        ({"speed": float("nan")}, "speed=nan"),
        ({"speed": "fast"}, "speed='fast'"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    run = car().simulate(0.2, seed=1, engine="interpreted")
    with pytest.raises(ModelError, match=message):
        run.animate(**settings)


def test_runs_with_nothing_to_animate_are_refused():
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Constant(1.0), "one")
    with pytest.raises(ModelError, match="has 1 rows, but an animation needs 2"):
        diagram.simulate(0.0, engine="interpreted").animate()
    with pytest.raises(ModelError, match="no scalar signal"):
        diagram.simulate(0.2, engine="interpreted", record=[]).animate()


@pytest.mark.slow
def test_saved_pictures_are_those_of_the_figure():
    """What does not move is drawn once for all pictures: nothing of an earlier picture may stay."""
    run = car(faults=[cosim.Injection(sensor=0, start=0.1, magnitude=8.0)]).simulate(0.2, seed=1, engine="interpreted")
    animation = keep(run.animate(frames=3))
    pictures = _Pictures(animation.figure, animation.moving)
    for k in (0, 2, 1):
        show(animation, k)
        shared, whole = io.BytesIO(), io.BytesIO()
        pictures.write(shared, format="png", dpi=60)
        animation.figure.savefig(whole, format="png", dpi=60)
        a, b = (imread(io.BytesIO(each.getvalue())) for each in (shared, whole))
        assert a.shape == b.shape
        assert (np.abs(a - b) > 0.02).any(axis=2).mean() < 0.002  # lines that cross may be drawn in another order


@pytest.mark.slow
def test_pictures_of_a_page_are_those_of_the_figure_and_small():
    """A page has only the differences from the first picture, which lies below them."""
    run = car(faults=[cosim.Injection(sensor=0, start=0.1, magnitude=8.0)]).simulate(0.2, seed=1, engine="interpreted")
    animation = keep(run.animate(frames=3))
    pictures = _Differences(animation.figure, animation.moving)
    for k in (0, 2, 1):
        show(animation, k)
        raw, part = io.BytesIO(), io.BytesIO()
        pictures.write(raw, format="rgba", dpi=60)
        pictures.write(part, format="png", dpi=60)
        shown = Image.fromarray(pictures.first)
        shown.alpha_composite(Image.open(part).convert("RGBA"))
        assert shown.tobytes() == raw.getvalue()
    assert len(animation.to_jshtml()) < 150_000
