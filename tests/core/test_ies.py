"""IES files: what is read of them, and the numbers between."""

import numpy as np
import pytest

from lumigate.core.surfaces import ies

HEAD = "IESNA:LM-63-1995\n[TEST] 1\nTILT=NONE\n"


def text(kind, v, h, table, factor=1.0, tilt="TILT=NONE\n"):
    numbers = "\n".join(" ".join(map(str, row)) for row in (v, h, *table))
    return f"IESNA:LM-63-1995\n[TEST] 1\n{tilt}1 1000 {factor} {len(v)} {len(h)} {kind} 2 0 0 0\n0.9 1 100\n{numbers}\n"


def test_candela_are_watts_of_a_lamp():
    lamp = ies.parse(text(1, [0, 90], [0], [[100, 100]], factor=2))
    assert lamp.intensity == pytest.approx(100 * 2 * 0.9 * 4 * np.pi / 177.83, rel=1e-5)
    assert np.degrees(lamp.h_angles) == pytest.approx([0, 360])


@pytest.mark.parametrize(
    ("kind", "v", "h", "angles", "rows"),
    [
        (1, [0, 90], [0, 45, 90], [0, 45, 90, 135, 180, 225, 270, 315, 360], [0, 1, 2, 1, 0, 1, 2, 1, 0]),
        (1, [0, 90], [0, 90, 180], [0, 90, 180, 270, 360], [0, 1, 2, 1, 0]),
        (1, [0, 90], [90, 180, 270], [0, 90, 180, 270, 360], [0, 1, 2, 1, 0]),
        (1, [0, 90], [0, 120, 240], [0, 120, 240, 360], [0, 1, 2, 0]),
        (3, [-90, 90], [0, 45, 90], [90, 135, 180, 225, 270], [2, 1, 0, 1, 2]),
        (3, [-90, 90], [-90, 0, 90], [90, 180, 270], [2, 1, 0]),
    ],
)
def test_horizontal_angles_are_completed(kind, v, h, angles, rows):
    lamp = ies.parse(text(kind, v, h, [[10 * (k + 1)] * 2 for k in range(len(h))]))
    assert np.degrees(lamp.h_angles) == pytest.approx(angles)
    np.testing.assert_allclose(lamp.intensity[:, 0] / lamp.intensity.max() * 10 * len(h), 10 * (np.array(rows) + 1), rtol=1e-5)


def test_type_b_is_turned_over():
    lamp = ies.parse(text(2, [0, 45, 90], [-90, 0, 90], [[1, 2, 3], [4, 5, 6], [7, 8, 9]]))
    assert np.degrees(lamp.h_angles) == pytest.approx([0, 45, 90, 135, 180])
    assert np.degrees(lamp.v_angles) == pytest.approx([0, 90, 180])
    unit = lamp.intensity / lamp.intensity[2, 0]
    np.testing.assert_allclose(unit, [[3, 6, 9], [2, 5, 8], [1, 4, 7], [2, 5, 8], [3, 6, 9]], rtol=1e-5)


def test_tilt_and_commas():
    plain = ies.parse(text(1, [0, 45, 90], [0], [[3, 2, 1]]))
    other = ies.parse(
        text(1, [0, 45, 90], [0], [[3, 2, 1]], tilt="TILT=INCLUDE\n1\n2\n0 90\n1 0.5\n").replace("0 45 90", "0,45,90").replace("\n", "\r\n")
    )
    np.testing.assert_array_equal(plain.intensity, other.intensity)


@pytest.mark.parametrize(
    "bad",
    ["", "nothing", HEAD, HEAD + "1 1000 1 2 1 1 2 0 0 0 1 1 100 0 90 0 5", text(4, [0, 90], [0], [[1, 1]]), text(1, [0], [0], [[1]])],
)
def test_what_is_no_ies_file(bad):
    with pytest.raises(ies.BadIes):
        ies.parse(bad)


def test_splines_pass_the_numbers_and_end_where_these_do():
    lamp = ies.parse(text(1, [0, 30, 60, 90], [0, 90], [[8, 6, 3, 1], [8, 5, 1, 0]]))
    h, v = np.meshgrid(lamp.h_angles[:-1], lamp.v_angles[:-1], indexing="ij")
    for continued in (False, True):
        np.testing.assert_allclose(ies.look_up(lamp, h, v, continued=continued), lamp.intensity[:-1, :-1], rtol=1e-9)
        assert ies.look_up(lamp, np.array(1.0), np.radians(90.1), continued=continued) == 0
    # A quadratic is met exactly within.
    v = np.radians(np.arange(0, 91, 10.0))
    curved = ies.Photometry(np.radians([0, 360.0]), v, np.tile(1 + v**2, (2, 1)))
    between = np.linspace(v[1], v[-2], 40)
    np.testing.assert_allclose(ies.look_up(curved, np.full(40, 1.0), between, continued=True), 1 + between**2, rtol=1e-9)


def test_image_of_a_symmetrical_lamp_is_one_column():
    lamp = ies.parse(text(1, [0, 90], [0], [[100, 50]]))
    assert ies.image(lamp, continued=True).shape == (ies.HEIGHT, 1, 1)
    image = ies.image(ies.parse(text(1, [0, 90], [0, 180], [[100, 50], [90, 40]])), continued=True)
    assert image.shape == (ies.HEIGHT, ies.WIDTH, 1)
    assert image[: ies.HEIGHT // 3].min() > 0
    assert not image[ies.HEIGHT // 2 :].any()
