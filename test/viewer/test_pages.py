# SPDX-License-Identifier: Apache-2.0
"""What the pages that teach show, against closed forms."""

import numpy as np
import pytest

from cloth_sim_ros.study.closed_forms import oscillator
from cloth_sim_ros.study.relaxation import HangingRope
from cloth_sim_ros.viewer.drawing import Click, Drag
from cloth_sim_ros.viewer.pages import colouring, integrators, iterations, spring_network, whole_cloth

G = 9.81  # [m/s^2]


# -- a. springs ------------------------------------------------------------------------------------------------------


@pytest.fixture
def springs(open_page):
    page = open_page(spring_network.SpringNetwork)
    page.advance()
    return page


def test_the_numbers_of_springs_are_those_of_a_grid(springs):
    n = spring_network.SIDE
    numbers = {kind: number for kind, (number, _) in springs.show().items()}
    assert numbers == {"structural": 2 * n * (n - 1), "shear": 2 * (n - 1) ** 2, "bending": 2 * n * (n - 2)}
    assert "| structural | 480 |" in springs._numbers.content


def test_alone_structural_springs_carry_the_weight_below(springs):
    n, sim = spring_network.SIDE, springs.stage.sim
    springs.switches["shear"].value = springs.switches["bending"].value = False
    springs.sliders["structural"].value, springs.pins.value = 1e-2, "top"
    sim.set("solver.global_damping", 4.0)
    sim.set_collider_pose("ball", (0.0, 50.0, 0.0), sweep=False)
    flat = sim.rest_positions("sheet")
    top = flat[:, 1].max()
    springs.advance()
    sim.set_positions("sheet", np.stack([flat[:, 0], np.full(n * n, top), 1.2 - (top - flat[:, 1])], axis=1))
    for _ in range(400):
        springs.advance()
    particle = 0.3 / (n - 1) ** 2
    below = (n - 1 - 0.5) * particle  # of an inner column, whose last particle has half a cell
    expected = below * G * 1e-2 * (n - 1)  # elongation over the length of a cell
    assert springs.show()["structural"][1] == pytest.approx(expected, rel=2e-3)
    assert "| shear | off | |" in springs._numbers.content


def test_a_sheet_without_shear_springs_shears(springs):
    def largest(frames: int) -> float:
        springs.stage.sim.reset()
        for _ in range(frames):
            springs.advance()
        return springs.show()["shear"][1]

    held = largest(90)
    springs.switches["shear"].value = False
    assert held < 0.1 and largest(90) > 3.0 * held


def test_springs_are_drawn_between_their_particles_and_hidden_when_off(springs):
    positions = springs.stage.sim.positions("sheet")
    sides = springs.drawing.handles["sheet"].vertices.reshape(2, -1, 3)
    assert np.allclose(sides.mean(axis=0), positions, atol=1e-6) and np.abs(sides - positions).max() < 1e-3
    assert np.array_equal(springs.drawing.handles["shear"].vertices[: len(positions)], positions)
    springs.switches["shear"].value = False
    springs.advance()
    assert "shear" not in springs.drawing.handles and "structural" in springs.drawing.handles


# -- b. integrators --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [5.0, 20.0, 60.0])  # [ms]
def test_energies_are_those_of_the_closed_forms(open_page, step):
    page = open_page(integrators.Integrators)
    page.length.value = step
    page.start()
    count = 15  # as long as forward Euler keeps the mass on its side of the anchor
    for _ in range(count):
        page.step()
    theta = integrators.FREQUENCY * page.h
    turned = count * 2.0 * np.arcsin(0.5 * theta)
    found = page.energies
    assert found["forward Euler"] == pytest.approx(np.abs(oscillator.forward_euler(theta)) ** (2 * count), rel=1e-9)
    implicit = np.abs(oscillator.implicit_euler(theta)) ** (2 * count)
    assert found["implicit Euler"] == pytest.approx(implicit, rel=1e-6)
    assert found["XPBD"] == pytest.approx(implicit, rel=2e-3, abs=1e-6)
    verlet = np.cos(turned) ** 2 + (1.0 - 0.25 * theta**2) * np.sin(turned) ** 2
    assert found["Verlet"] == pytest.approx(verlet, rel=1e-9)
    assert f"| forward Euler | {found['forward Euler']:.4g} |" in drawn(page)._numbers.content


def drawn(page):
    """The page after drawing alone."""
    page._draw()
    return page


def test_verlet_leaves_its_bounds_beyond_two(open_page):
    page = open_page(integrators.Integrators)
    page.length.value = 1e3 * 2.2 / integrators.FREQUENCY
    page.start()
    for _ in range(30):
        page.step()
    assert page.energies["Verlet"] > 1e6 and page.energies["implicit Euler"] < 1e-9


def test_cloths_gain_keep_and_lose_energy(open_page):
    page = open_page(integrators.Integrators)
    for _ in range(150):
        page.frame()
    assert "forward Euler" in page._gone
    assert abs(page._cloth_energy("Verlet")) < 0.02
    assert page._cloth_energy("implicit Euler") < -0.1 and page._cloth_energy("XPBD") < -0.1


def test_names_of_neighbouring_cloths_stand_at_two_heights(open_page):
    labels = open_page(integrators.Integrators).drawing.handles
    heights = [labels[f"{name} label"].position[2] for name in integrators.METHODS]
    assert (np.abs(np.diff(heights)) > 0.1).all() and len(heights) == 4


# -- c. iterations ---------------------------------------------------------------------------------------------------


def test_one_segment_needs_one_iteration():
    mass, compliance = 0.2, 1e-2  # [kg], [m/N]
    for each, expected in ((None, 0.0), (compliance, mass * G * compliance)):
        rope = HangingRope(np.zeros(3), np.array([mass, mass]), np.array([1.0]), each, damping=3.0)
        for _ in range(600):
            rope.step(np.zeros(3), 1 / 60, 4, 1, G)
        assert rope.stretch == pytest.approx(expected, abs=1e-6)


@pytest.mark.long
def test_stretch_falls_with_iterations_and_xpbd_comes_to_the_closed_form(open_page, monkeypatch):
    page = open_page(iterations.Iterations)
    counts = (1, 4, 16, 64, 800)
    monkeypatch.setattr(iterations, "COUNTS", counts)
    compliance = 10.0**-1.5
    for _ in page.measure(compliance, 1):
        pass
    found = np.array(page.measured)
    assert tuple(found[:, 0]) == counts
    assert (np.diff(found[:, 1]) < 0.0).all() and found[-1, 1] < 1e-3  # PBD becomes rigid, whatever the material
    assert (np.diff(found[:, 2]) < 0.0).all()
    assert found[-1, 2] == pytest.approx(iterations.stretch_at_rest(compliance), rel=0.01)
    assert np.allclose(page._chart.data[3], 100.0 * iterations.stretch_at_rest(compliance))


def test_the_packages_rope_has_the_stretch_of_the_closed_form(open_page):
    page = open_page(iterations.Iterations)
    page.swing.value = False
    for _ in range(500):
        page.advance()
    assert page.stretch["this package"] == pytest.approx(iterations.stretch_at_rest(page._compliance), rel=5e-3)
    assert page.stretch["PBD"] > page.stretch["this package"]  # with four iterations


def test_ropes_are_led_by_the_mouse(open_page):
    page = open_page(iterations.Iterations)
    start = page._points("PBD")[3].copy()
    page.dragged(Drag("PBD", "start", start, start))
    page.dragged(Drag("PBD", "update", start, start + (0.2, 0.1, 0.0)))
    for _ in range(3):
        page.advance()
    for name, place in iterations.PLACES.items():
        assert np.allclose(page._points(name)[0], place + (0.2, 0.1, 0.0), atol=1e-5)


# -- d. colours ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", colouring.SHAPES)
def test_springs_of_one_colour_share_no_particle(shape):
    _, pairs, colours = colouring.shape_of(shape)
    for each in range(colours.max() + 1):
        particles = pairs[colours == each].ravel()
        assert len(particles) and len(np.unique(particles)) == len(particles)
    fewest = np.bincount(pairs.ravel()).max()  # springs at one particle need as many colours
    assert fewest <= colours.max() + 1
    if shape != colouring.SHAPES[2]:
        assert fewest == colours.max() + 1


@pytest.fixture
def net(open_page):
    page = open_page(colouring.Colouring)
    page.play.value = False
    page.advance()
    return page


def test_colours_lose_no_write_and_races_lose_all_but_one_at_each_particle(net):
    net.press("a sweep")
    assert net.lost == 0 and net.done == 4
    net.order.value = colouring.ORDERS[2]
    net.advance()
    net.press("a sweep")
    n = colouring.SIDE
    assert net.lost == 2 * 2 * n * (n - 1) - n * n and net.done == 1
    assert f"| writes lost in it | {net.lost} |" in net._numbers.content


@pytest.mark.parametrize("shape", colouring.SHAPES)
def test_the_order_within_a_colour_does_not_matter(net, shape):
    net.shape.value = shape
    net.advance()
    start = net.springs.x.copy()
    net.press("a sweep")
    parallel = net.springs.x.copy()
    net.springs.x = start
    multipliers = np.zeros(len(net.springs.pairs))
    for chosen in net.passes:
        for spring in np.random.default_rng(0).permutation(chosen):
            net.springs.race(np.array([spring]), multipliers, 1.0)
    assert np.array_equal(net.springs.x, parallel)


def test_the_error_falls_to_nothing_by_colours_and_not_by_races(net):
    errors = {}
    for order in (colouring.ORDERS[0], colouring.ORDERS[2]):
        net.shape.value, net.order.value = colouring.SHAPES[2], order
        net.advance()
        for _ in range(200):
            net.press("a sweep")
        errors[order] = net.error
    assert errors[colouring.ORDERS[0]] < 1e-6 < 1e-3 < errors[colouring.ORDERS[2]]


# -- e. the whole cloth ----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_whole_cloth_weighs_on_the_ball_and_is_dragged(open_page):
    page = open_page(whole_cloth.WholeCloth)
    sim = page.stage.sim
    normals = page.particles()[:, 3:]
    assert np.allclose(np.abs(normals), (0.0, 0.0, 1.0), atol=1e-5)  # it lies flat
    sim.set("solver.global_damping", 3.0)
    for _ in range(240):
        page.advance()
    force = np.mean([(page.advance(), sim.wrench("ball")[0])[1] for _ in range(60)], axis=0)
    assert np.allclose(force, (0.0, 0.0, -0.3 * G), atol=0.02 * 0.3 * G)
    corner = sim.positions("cloth")[0].astype(float)
    goal = corner + (-0.1, -0.1, 0.1)
    page.dragged(Drag("cloth", "start", corner, corner))
    assert page.stage.dragged == ("cloth", 0)
    for k in range(1, 31):
        page.dragged(Drag("cloth", "update", corner, corner + k / 30 * (goal - corner)))
        page.advance()
    assert np.linalg.norm(sim.positions("cloth")[0] - goal) < 1e-4
    page.dragged(Drag("cloth", "end", corner, goal))
    assert page.stage.dragged is None and sim.held("hand") == 0
    page.wind[1].value, page.friction.value, page.normals.value = 3.0, 1.2, True
    page.advance()
    assert tuple(sim.get("wind.velocity")) == pytest.approx((0.0, 3.0, 0.0))
    assert sim.get("ball.static_friction") == pytest.approx(1.2)
    assert len(page.drawing.handles["normals"].vertices) == 3 * whole_cloth.SIDE**2


@pytest.mark.long
def test_two_clicks_cut_the_whole_cloth_between_them(open_page):
    page = open_page(whole_cloth.WholeCloth)
    sim, n, eye = page.stage.sim, whole_cloth.SIDE, np.array([0.0, 0.0, 3.0])
    page.advance()
    whole = len(page.drawing.handles["cloth"].faces)
    assert whole == 2 * 2 * (n - 1) ** 2 + 2 * 4 * (n - 1), "both sides and the hem"
    ends = [16 * n + 4, 16 * n + 27]
    for vertex in (ends[0], ends[0], ends[1]):
        way = sim.positions("cloth")[vertex] - eye
        page.clicked(Click("cloth", eye, way / np.linalg.norm(way)))
    failed = sim.springs("cloth")["structural"][0][sim.torn("cloth")["structural"]]
    rows, columns = np.sort(failed // n, axis=1), failed % n
    assert (rows[:, 0] + 1 == rows[:, 1]).all() and (np.abs(rows - 16) <= 1).all(), "they lie across the cut"
    assert columns.min() >= 4 and columns.max() <= 27 and 22 <= len(failed) <= 24
    page.advance()
    faces = page.drawing.handles["cloth"].faces
    front = (faces < len(sim.positions("cloth"))).all(axis=1).sum()
    assert front == len(sim.triangles("cloth")) < 2 * (n - 1) ** 2
