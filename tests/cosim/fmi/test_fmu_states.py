"""Saved states of FMU instances: to save and go back changes nothing else, and a state outlives its instance as bytes."""

import gc
import pickle
import zipfile
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import fmus
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.fmu import FMU

STEP = Fraction(1, 50)
FMI = ("2.0", "3.0")


def arm(fmi="2.0", path=None):
    block = FMU(path or fmus.path("TwoLinkArm", fmi=fmi), parameters={"q1_0": 0.3})
    return block.instantiate(STEP, "arm")


def moved(instance, begin, end):
    """Return the outputs at the end of steps under a torque that changes."""
    inputs, outputs = np.zeros(2), np.zeros(6)
    for k in range(begin, end):
        inputs[0] = 5.0 * (-1) ** k
        assert instance.update(inputs, outputs, k / 50) == 0
    assert instance.output(inputs, outputs, end / 50) == 0
    return outputs.tolist()


def without(capability, fmi, target):
    """Copy the arm without a capability that it had."""
    with zipfile.ZipFile(fmus.path("TwoLinkArm", fmi=fmi)) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                said = f'{capability}{"state" if fmi == "2.0" else "State"}="true"'.encode()
                assert said in content
                content = content.replace(said, said.replace(b"true", b"false"))
            new.writestr(name, content)
    return target


@pytest.mark.parametrize("fmi", FMI)
def test_a_restored_instance_goes_on_as_it_did(fmi):
    instance, undisturbed = arm(fmi), arm(fmi)
    assert instance.can_save
    moved(instance, 0, 7)
    saved = instance.save()
    there = moved(instance, 7, 20)
    for _ in range(2):
        instance.restore(saved)
        assert moved(instance, 7, 20) == there
    assert moved(undisturbed, 0, 20) == there
    instance.forget(saved)
    with pytest.raises(FMUError, match=r"'TwoLinkArm' no longer exists: it was deleted"):
        instance.restore(saved)
    instance.close()
    undisturbed.close()


@pytest.mark.parametrize("fmi", FMI)
def test_a_saved_state_becomes_bytes(fmi):
    instance, other = arm(fmi), arm(fmi)
    moved(instance, 0, 7)
    saved = instance.save()
    copy = pickle.loads(pickle.dumps(saved))
    there = moved(instance, 7, 20)
    other.restore(saved)
    assert moved(other, 7, 20) == there
    instance.close()  # the state outlives its instance
    for state in (saved, copy, pickle.loads(pickle.dumps(copy))):
        other.restore(state)
        assert moved(other, 7, 20) == there
    other.close()


def test_places_are_given_back_to_the_fmu():
    instance, freed = arm(), []
    call = instance._library.call

    def counted(function, *arguments):
        freed.extend([function] if "Free" in function else [])
        return call(function, *arguments)

    instance._library.call = counted
    try:
        kept = instance.save()
        for _ in range(5):
            instance.save()
        gc.collect()
        instance.close()
        assert freed == [*["fmi2FreeFMUstate"] * 6, "fmi2FreeInstance"]  # all, and before the instance goes
        assert len(pickle.dumps(kept)) > 100
    finally:
        del instance._library.call


@pytest.mark.parametrize("fmi", FMI)
def test_what_an_fmu_cannot_is_said(fmi, tmp_path):
    mute = arm(path=without("canGetAndSetFMU", fmi, tmp_path / "mute.fmu"))
    assert not mute.can_save
    with pytest.raises(
        FMUError, match=r"'TwoLinkArm' \('arm'\) cannot save its state, as it does not declare canGetAndSet"
    ):
        mute.save()
    mute.close()
    instance = arm(path=without("canSerializeFMU", fmi, tmp_path / "bound.fmu"))
    saved = instance.save()
    moved(instance, 0, 2)
    instance.restore(saved)
    with pytest.raises(FMUError, match=r"cannot be pickled, as the FMU does not declare canSerializeFMUState"):
        pickle.dumps(saved)
    other = arm(path=tmp_path / "bound.fmu")
    with pytest.raises(FMUError, match=r"is from another run, and the FMU .* cannot serialise"):
        other.restore(saved)
    instance.close()
    with pytest.raises(FMUError, match=r"no longer exists"):
        pickle.dumps(saved)
    other.close()


def test_the_state_of_another_fmu_is_refused():
    instance, other = arm("2.0"), arm("3.0")
    with pytest.raises(
        FMUError, match=r"is no saved state of the FMU 'TwoLinkArm' but one of 'TwoLinkArm'\. Give a state from"
    ):
        other.restore(instance.save())
    with pytest.raises(FMUError, match=r"is no saved state of the FMU 'TwoLinkArm'\. Give a state from a run"):
        other.restore("state")
    instance.close()
    other.close()


def test_a_failed_instance_can_be_put_back():
    instance = arm()
    saved = instance.save()
    outputs = np.zeros(6)
    status = instance.update(np.zeros(2), outputs, 9.0)  # not the time at which it stands
    assert "fmi2DoStep returned Error" in instance.explain(status)
    instance.restore(saved)
    assert moved(instance, 0, 3) == moved_afresh(3)
    instance.close()


def moved_afresh(steps):
    instance = arm()
    try:
        return moved(instance, 0, steps)
    finally:
        instance.close()
