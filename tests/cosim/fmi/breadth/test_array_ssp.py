"""Arrays in system structures (SSP 2.0)."""

import dataclasses
import re
import zipfile

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import SSPError


def of_arrays(mixer, **start):
    ports = {"inputs": ["u", "single", "flag"], "outputs": ["y", "total", "flag_out"]}
    return dataclasses.replace(mixer(**start), **ports)


def two_mixers(mixer, **second):
    diagram = cosim.Diagram(dt="1/16")
    first = diagram.add(of_arrays(mixer, u=[1.0, 2.0, 3.0], k=0.5), "first")
    last = diagram.add(of_arrays(mixer, flag=True, **second), "last")
    diagram.connect(first["y"], last["u"])
    return diagram


def rewritten(path, target, *changes):
    """Copy an SSP, with changes of its text."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as new:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith(".ssd"):
                for old, text in changes:
                    assert old.encode() in content
                    content = content.replace(old.encode(), text.encode(), 1)
            new.writestr(name, content)
    return target


def test_arrays_go_into_an_ssp_and_come_back(mixer, tmp_path, monkeypatch, same_bits):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = cosim.save_ssp(two_mixers(mixer), tmp_path / "arrays.ssp")
    text = zipfile.ZipFile(path).read("SystemStructure.ssd").decode()
    assert 'version="2.0"' in text
    assert 'version="1.0"' not in text.partition("?>")[2]
    ours = two_mixers(mixer).build("jacobi").simulate(1, engine="interpreted")
    for again in (path, rewritten(path, tmp_path / "types.ssp", ("<ssv:Real value=", "<ssv:Float64 value="))):
        run = cosim.open_ssp(again).build("jacobi").simulate(1, engine="interpreted")
        for name in ("first.y", "last.y", "last.flag_out"):
            same_bits(run[name], ours[name], name)
    assert np.abs(ours["last.y"][-1]).min() > 0.1
    open_size = rewritten(
        path, tmp_path / "open.ssp", ('<ssc:Dimension size="3" />', '<ssc:Dimension sizeConnector="n" />')
    )
    cosim.open_ssp(open_size)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('Dimension size="3"', 'Dimension size="2"', "declares first.u as an array of 2, but in .* its shape is (3,)"),
        ('Dimension size="3" />', 'Dimension size="3"/><ssc:Dimension/>', "declares first.u as an array of 3 x ?, but in"),
        ('Dimension size="3"', 'Dimension size="-3"', "has a Dimension of size '-3', which is no whole number"),
        ('Dimension size="3"', 'Dimension size="three"', "has a Dimension of size 'three', which is no whole number"),
        ('value="1.0 2.0 3.0"', 'value="1.0 2.0"', "gives 'u' the value '1.0 2.0', which is not of type Real and shape (3,)"),
        ('value="1.0 2.0 3.0"', 'value="1.0 x 3.0"', "gives 'u' the value '1.0 x 3.0', which is not of type Real"),
        ('endConnector="u"', 'endConnector="u" endIndices="1"', "has indices in the connection from first.y to last.u, but SSP"),
        ('startConnector="y"', 'startConnector="total"', "connects first.total, of shape (), to last.u, of shape (3,)"),
        ('version="2.0" name="initialValues"', 'name="initialValues"', None),
    ],
)  # fmt: skip
def test_what_an_ssp_says_wrongly_of_arrays(mixer, tmp_path, monkeypatch, old, new, words):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = cosim.save_ssp(two_mixers(mixer), tmp_path / "arrays.ssp")
    wrong = rewritten(path, tmp_path / "wrong.ssp", (old, new))
    if words is None:
        cosim.open_ssp(wrong)
        return
    with pytest.raises(SSPError, match=re.escape(words).replace(r"\.\*", ".*")):
        cosim.open_ssp(wrong)


def test_elements_of_arrays_are_not_saved(mixer, tmp_path):
    element, crossed, constant = cosim.Diagram(dt=0.1), cosim.Diagram(dt=0.1), cosim.Diagram(dt=0.1)
    for diagram in (element, crossed, constant):
        diagram.add(of_arrays(mixer), "a")
        diagram.add(of_arrays(mixer), "b")
    element.connect(element["a"]["y[1]"], element["b"]["single"])
    crossed.connect([crossed["a"]["y"][2], crossed["a"]["y"][:2]], crossed["b"]["u"])
    constant.connect(constant.add(cosim.Constant(1.0), "one")["y"], constant["b"]["u[0]"])
    for diagram, words in (
        (element, "b.single is fed by an element of a.y"),
        (crossed, "b.u is an array, and an SSP can connect it only to a whole array"),
        (constant, "b.u is an array, and an SSP can connect it only to a whole array"),
    ):
        with pytest.raises(SSPError, match=words):
            cosim.save_ssp(diagram, tmp_path / "x.ssp")
