import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.method.pose.camera import Camera
from cageik_cli.util.errors import SettingError
from tests.shapes import rotation

WIDTH, HEIGHT = 640, 480


def frustum(left, right, bottom, top, near, far):
    """As OpenGL's reference has it for glFrustum."""
    return np.array(
        [
            [2 * near / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 * near / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def orthographic(left, right, bottom, top, near, far):
    """As OpenGL's reference has it for glOrtho."""
    low, high = np.array([left, bottom, near]), np.array([right, top, far])
    matrix = np.diag([*(2 / (high - low) * [1, 1, -1]), 1.0])
    matrix[:3, 3] = -(high + low) / (high - low)
    return matrix


def view(seed=1, shift=(0.3, -0.2, -6.0)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(seed), shift
    return matrix


FRUSTUM = frustum(-0.4, 0.6, -0.3, 0.5, 1.0, 20.0)
PARALLEL = orthographic(-4.0, 3.0, -2.0, 4.0, 1.0, 20.0)
POSITION, TARGET, UP = np.array([4.0, 5.0, 3.0]), np.array([0.1, 0, -0.2]), np.array([0.0, 0, 2.0])


def stand(position=POSITION, target=TARGET, up=UP, degrees=40.0, width=WIDTH, height=HEIGHT):
    """A camera that looks from a place at another."""
    return Camera.from_look_at(
        position, target, up=up, fov_degrees=degrees, width=width, height=height
    )


CAMERAS = {
    "frustum": Camera(view(), FRUSTUM, WIDTH, HEIGHT),
    "parallel": Camera(view(), PARALLEL, WIDTH, HEIGHT),
    "without a far plane": stand(),
}
POINTS = np.random.default_rng(0).normal(size=(50, 3))

points = st.tuples(*[st.floats(-1.5, 1.5)] * 3).map(np.array)
pixels = st.tuples(st.floats(-100, 740), st.floats(-100, 580)).map(np.array)
cameras = st.sampled_from(list(CAMERAS.values()))


@pytest.fixture(params=CAMERAS.values(), ids=CAMERAS)
def camera(request):
    return request.param


def test_what_is_at_the_corners_of_the_frustum_is_seen_at_the_corners_of_the_picture():
    camera = Camera(np.eye(4), FRUSTUM, WIDTH, HEIGHT)
    near = np.array([[-0.4, 0.5, -1], [0.6, 0.5, -1], [-0.4, -0.3, -1], [0.6, -0.3, -1]])
    seen = np.array([[0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT]])
    for scale, depth in ((1, -1), (20, 1)):
        expected = np.column_stack([seen, np.full(4, depth)])
        np.testing.assert_allclose(camera.project(scale * near), expected, atol=1e-11)


def test_what_is_at_the_corners_of_the_box_is_seen_at_the_corners_of_the_picture():
    camera = Camera(np.eye(4), PARALLEL, WIDTH, HEIGHT)
    box = np.array([[-4, 4, -1], [3, 4, -20], [-4, -2, -20], [3, -2, -1.0]])
    expected = [[0, 0, -1], [WIDTH, 0, 1], [0, HEIGHT, 1], [WIDTH, HEIGHT, -1]]
    np.testing.assert_allclose(camera.project(box), expected, atol=1e-11)


def test_a_frustum_is_seen_as_by_similar_triangles():
    eye = POINTS @ view()[:3, :3].T + view()[:3, 3]
    x, y = -eye[:, 0] / eye[:, 2], -eye[:, 1] / eye[:, 2]
    expected = np.column_stack([(x + 0.4) / 1.0 * WIDTH, (0.5 - y) / 0.8 * HEIGHT])
    seen = CAMERAS["frustum"].project(POINTS)[:, :2]
    np.testing.assert_allclose(seen, expected, atol=1e-10)


def test_a_stand_sees_what_it_looks_at_in_the_middle_and_up_upright():
    camera = CAMERAS["without a far plane"]
    middle, above = camera.project(np.array([TARGET, TARGET + np.array([0, 0, 0.1])]))
    np.testing.assert_allclose(middle[:2], [WIDTH / 2, HEIGHT / 2], atol=1e-10)
    assert above[0] == pytest.approx(WIDTH / 2)
    assert above[1] < middle[1]
    axes = camera.view[:3, :3]
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1)
    right = TARGET + 0.1 * np.cross(TARGET - POSITION, UP)
    assert camera.project(right)[0] > WIDTH / 2


@pytest.mark.parametrize(("width", "height"), [(640, 480), (300, 900)])
@pytest.mark.parametrize("degrees", [1e-3, 40.0, 179.0])
def test_the_field_of_view_is_the_angle_from_edge_to_edge(width, height, degrees):
    """Vertically; and pixels are square."""
    camera = stand(degrees=degrees, width=width, height=height)
    up, right = camera.view[1, :3], camera.view[0, :3]
    ahead = TARGET - POSITION
    reach = np.linalg.norm(ahead) * np.tan(np.radians(degrees) / 2)
    seen = camera.project(TARGET + reach * np.array([up, -up, right]))
    expected = [[width / 2, 0], [width / 2, height], [(width + height) / 2, height / 2]]
    np.testing.assert_allclose(seen[:, :2], expected, atol=1e-8)


def test_there_is_no_far_plane_and_a_near_one_that_is_very_near():
    camera = CAMERAS["without a far plane"]
    ahead = TARGET - POSITION
    depths = camera.project(POSITION + np.outer([1e-6, 1.0, 1e9], ahead))[:, 2]
    assert depths[0] == pytest.approx(-1, abs=1e-9)
    assert depths[0] < depths[1] < depths[2] <= 1
    assert camera.cast_rays(np.array([[3.0, 4.0]]))[2][0] > 1e9


@given(cameras, points)
def test_a_point_is_on_the_ray_of_the_pixel_in_which_it_is_seen(camera, point):
    seen = camera.project(point)
    (origin,), (direction,), (length,) = camera.cast_rays(seen[None, :2])
    away = point - origin
    along = away @ direction
    np.testing.assert_allclose(away, along * direction, atol=1e-9)
    assert 0 < along < length
    back = origin + along * direction
    np.testing.assert_allclose(camera.project(back), seen, atol=1e-9 * WIDTH)


@given(cameras, pixels)
def test_rays_go_from_the_near_to_the_far_plane(camera, pixel):
    (origin,), (direction,), (length,) = camera.cast_rays(pixel[None])
    assert np.linalg.norm(direction) == pytest.approx(1)
    start = camera.project(origin)
    np.testing.assert_allclose(start, [*pixel, -1], atol=1e-6)  # rounded, and very near the eye
    if camera is not CAMERAS["without a far plane"]:
        end = camera.project(origin + length * direction)
        np.testing.assert_allclose(end, [*pixel, 1], atol=1e-8)


@given(cameras, points, pixels)
def test_a_point_is_dragged_across_and_not_in_depth(camera, point, pixel):
    """By its distance from the eye's plane and the size of a pixel there: no inverse."""
    dragged = camera.move_to_pixels(point[None], pixel[None])[0]
    np.testing.assert_allclose(camera.project(dragged)[:2], pixel, atol=1e-8)
    axes = camera.view[:3, :3]
    moved = axes @ (dragged - point)
    assert moved[2] == pytest.approx(0, abs=1e-9)
    pixels_moved = pixel - camera.project(point)[:2]
    height = (camera.view @ [*point, 1])[2]
    w = -height if camera.projection[3, 2] else 1.0
    scale = 2 * w / np.array([camera.projection[0, 0], camera.projection[1, 1]])
    expected = pixels_moved / [WIDTH, -HEIGHT] * scale
    np.testing.assert_allclose(moved[:2], expected, atol=1e-9)


def test_what_is_dragged_nowhere_stays(camera):
    pixels = camera.project(POINTS)[:, :2]
    np.testing.assert_allclose(camera.move_to_pixels(POINTS, pixels), POINTS, atol=1e-12)


def test_points_of_any_shape_are_projected(camera):
    seen = camera.project(POINTS.reshape(5, 10, 3))
    np.testing.assert_array_equal(seen.reshape(-1, 3), camera.project(POINTS))
    np.testing.assert_allclose(camera.project(POINTS[3]), seen[0, 3], atol=1e-12)


@pytest.mark.parametrize("name", ["frustum", "without a far plane"])
def test_what_is_behind_the_viewer_is_refused(name):
    camera = CAMERAS[name]
    eye = -camera.view[:3, :3].T @ camera.view[:3, 3]
    behind = (eye + camera.view[2, :3])[None]
    for act in (camera.project, lambda p: camera.move_to_pixels(p, np.zeros((1, 2)))):
        with pytest.raises(SettingError, match="the point is behind the camera; choose"):
            act(behind)


def test_matrices_are_kept_and_cannot_be_changed(camera):
    with pytest.raises(ValueError, match="read-only"):
        camera.view[0, 0] = 1
    given = view()
    made = Camera(given, FRUSTUM, 10, 10)
    given[:] = 0
    np.testing.assert_array_equal(made.view, view())


def changed(matrix, row, column, value):
    matrix = matrix.copy()
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize(
    ("view", "projection", "says"),
    [
        (np.eye(3), FRUSTUM, r"view has shape \(3, 3\), expected \(4, 4\)"),
        (np.eye(4), FRUSTUM[None], r"projection has shape \(1, 4, 4\), expected \(4, 4\)"),
        (changed(view(), 0, 3, np.nan), FRUSTUM, "view holds numbers that are not finite"),
        (view(), changed(FRUSTUM, 1, 1, np.inf), "projection holds numbers that are not finite"),
        (changed(view(), 0, slice(None), 0), FRUSTUM, "view is singular; expected a matrix that"),
        (view(), changed(FRUSTUM, 1, 1, 0), "projection is singular; expected"),
        (view(), np.zeros((4, 4)), "projection is singular; expected"),
        (view().T, FRUSTUM, r"the last row of view is .*, expected 0, 0, 0, 1; matrices act on"),
        (view(), FRUSTUM.T, r"projection is 0, 0, -2.10526, 0, expected 0, 0, -1, 0 of a persp"),
        (view(), PARALLEL.T, r"projection is 0.142857, -0.333333, -1.10526, 1, expected"),
        (view(), FRUSTUM * [[1], [1], [-1], [-1]], "projection is .* 1, -?0, .*transpose both if"),
    ],
)
def test_matrices_that_are_no_cameras_are_refused(view, projection, says):
    with pytest.raises(SettingError, match=says):
        Camera(view, projection, WIDTH, HEIGHT)


@pytest.mark.parametrize("size", [0, -3, np.nan, np.inf])
def test_pictures_without_a_size_are_refused(size):
    with pytest.raises(SettingError, match=f"width is {size:g}"):
        Camera(view(), FRUSTUM, size, HEIGHT)
    with pytest.raises(SettingError, match=f"height is {size:g}"):
        Camera(view(), FRUSTUM, WIDTH, size)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_and_far_planes_make_no_matrix_singular(scale):
    far = view(shift=(3e6 * scale, 0, -5 * scale))
    camera = Camera(far, frustum(-scale, scale, -scale, scale, scale, 1e7 * scale), WIDTH, HEIGHT)
    ahead = np.linalg.solve(far, [0, 0, -7 * scale, 1])[:3]
    np.testing.assert_allclose(camera.project(ahead)[:2], [WIDTH / 2, HEIGHT / 2], rtol=1e-6)


@pytest.mark.parametrize("degrees", [0.0, -1.0, 180.0, np.nan])
def test_fields_of_view_that_see_nothing_are_refused(degrees):
    with pytest.raises(SettingError, match=f"fov_degrees is {degrees:g}, expected more than 0"):
        stand(degrees=degrees)


@pytest.mark.parametrize(
    ("position", "up", "says"),
    [
        ([1.0, 2, 3], [0.0, 0, 1], "position and look_at are the same point"),
        ([1.0, 2, 5], [0.0, 0, -4], "up is parallel"),
        ([1.0, 2, 5], [0.0, 0, 0], "up is parallel"),
        ([np.nan, 2, 5], [0.0, 0, 1], "position and look_at are the same point"),
    ],
)
def test_stands_that_look_nowhere_are_refused(position, up, says):
    with pytest.raises(SettingError, match=says):
        stand(np.array(position), np.array([1.0, 2, 3]), np.array(up))


def test_matrices_that_were_inverted_in_single_precision_are_taken():
    slipped = changed(view(), 3, 3, 1 + 1e-7)
    assert Camera(slipped, FRUSTUM, WIDTH, HEIGHT).view[3, 3] == 1 + 1e-7
    with pytest.raises(SettingError, match="the last row of view"):
        Camera(changed(view(), 3, 3, 1 + 1e-5), FRUSTUM, WIDTH, HEIGHT)
