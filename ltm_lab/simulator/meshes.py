"""Procedural meshes of plants and houses: triangles with a colour each, in metres, z up, standing on z = 0."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array

Rng = np.random.Generator


@dataclass(frozen=True)
class Soup:
    """`triangles` (N, 3, 3) metres, `colors` (N, 3) linear reflectances, `normals` (N, 3) unit, for the shading alone.

    Foliage is shaded by the crown that a leaf belongs to, not by the leaf: light passes between and through leaves, so
    a crown reads as a soft body, not as a heap of mirrors.
    """

    triangles: Float64Array
    colors: Float64Array
    normals: Float64Array

    def moved(self, x: float, y: float, scale: float, turn: float, tint: float = 1.0) -> "Soup":
        """Scaled, turned about z (radians), set at (x, y), its colours multiplied by `tint`."""
        c, s = np.cos(turn), np.sin(turn)
        rotation = scale * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Soup(
            self.triangles @ rotation.T + (x, y, 0.0),
            np.clip(self.colors * tint, 0.0, 0.95),
            self.normals @ rotation.T / scale,
        )

    @staticmethod
    def joined(parts: "list[Soup]") -> "Soup":
        return Soup(
            np.concatenate([p.triangles for p in parts]),
            np.concatenate([p.colors for p in parts]),
            np.concatenate([p.normals for p in parts]),
        )


def _unit(v: Float64Array) -> Float64Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12), np.float64)


def _faces(triangles: Float64Array) -> Float64Array:
    """Geometric unit normals (N, 3)."""
    return _unit(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))


def _directions(rng: Rng, n: int, lowest: float) -> Float64Array:
    """Unit vectors spread evenly over the sphere's part with z >= lowest."""
    z = lowest + (1 - lowest) * (np.arange(n) + rng.uniform(0.2, 0.8, n)) / n
    angle = np.arange(n) * 2.399963 + rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(np.maximum(0.0, 1 - z * z))
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def cards(
    rng: Rng, center: Float64Array, outward: Float64Array, size: float, color: Float64Array, spread: float = 0.55
) -> Soup:
    """Leaf clumps: one ragged quad at each centre, facing about `outward`, brighter the higher it faces."""
    n = len(center)
    normal = outward + spread * rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    helper = rng.normal(size=(n, 3))
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    half = size * rng.uniform(0.55, 1.15, (n, 1))
    corners = [
        center + half * (a * u + b * v) * rng.uniform(0.6, 1.25, (n, 1))
        for a, b in ((-1, -0.6), (1, -0.7), (0.8, 0.9), (-0.7, 0.8))
    ]
    triangles = np.concatenate([np.stack(corners[:3], axis=1), np.stack([corners[0], corners[2], corners[3]], axis=1)])
    light = 0.85 + 0.2 * np.clip(outward[:, 2], -0.5, 1) + 0.2 * rng.normal(size=n)
    tint = color * np.clip(light, 0.3, 1.7)[:, None] * (1 + 0.05 * rng.normal(size=(n, 3)))
    shade = _unit(outward + 0.3 * rng.normal(size=(n, 3)) + (0, 0, 0.25))
    return Soup(triangles, np.clip(np.concatenate([tint, tint]), 0.005, 0.9), np.concatenate([shade, shade]))


def lump(
    rng: Rng, radius: tuple[float, float, float], z: float, color: Float64Array, rings: int = 4, sides: int = 7
) -> Soup:
    """A closed lumpy ellipsoid about (0, 0, z): the dark inside of a crown, or a whole far plant."""
    theta = np.linspace(0, np.pi, rings + 1)
    phi = np.arange(sides) * 2 * np.pi / sides + rng.uniform(0, 1)
    grid = np.empty((rings + 1, sides, 3))
    bump = 1 + 0.22 * rng.normal(size=(rings + 1, sides)).clip(-1.5, 1.5)
    bump[[0, -1]] = 1
    for i, t in enumerate(theta):
        grid[i] = np.stack([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), np.full(sides, np.cos(t))], axis=1)
    points = grid * bump[..., None] * np.array(radius) + (0, 0, z)
    shade = (0.62 + 0.38 * grid[..., 2])[..., None] * color * (1 + 0.12 * rng.normal(size=(rings + 1, sides, 1)))
    triangles, colors, normals = [], [], []
    outward = grid / np.array(radius)
    for i in range(rings):
        j = (np.arange(sides) + 1) % sides
        a, b, c, d = (i, np.arange(sides)), (i + 1, np.arange(sides)), (i + 1, j), (i, j)
        for tri in ((a, b, c), (a, c, d)):
            triangles.append(np.stack([points[k] for k in tri], axis=1))
            colors.append(np.mean([shade[k] for k in tri], axis=0))
            normals.append(np.mean([outward[k] for k in tri], axis=0))
    return Soup(np.concatenate(triangles), np.clip(np.concatenate(colors), 0.005, 0.9), _unit(np.concatenate(normals)))


def _trunk(
    height: float, radius: float, color: Float64Array, lean: tuple[float, float] = (0.0, 0.0), sides: int = 5
) -> Soup:
    phi = np.arange(sides + 1) * 2 * np.pi / sides
    foot = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.full(sides + 1, -0.6)], axis=1)
    top = np.stack(
        [0.5 * radius * np.cos(phi) + lean[0], 0.5 * radius * np.sin(phi) + lean[1], np.full(sides + 1, height)], axis=1
    )
    triangles = np.concatenate(
        [np.stack([foot[:-1], foot[1:], top[1:]], axis=1), np.stack([foot[:-1], top[1:], top[:-1]], axis=1)]
    )
    return Soup(triangles, np.broadcast_to(color, (len(triangles), 3)).copy(), _faces(triangles))


def shrub(rng: Rng, radius: float, height: float, color: Float64Array, leaves: int) -> Soup:
    """A chaparral shrub: two to four overlapping domes of leaf clumps over a dark inside, ragged at the rim.

    More `leaves` make them smaller; the domes stay the same.
    """
    foliage = np.random.default_rng(int(rng.integers(2**31)))
    parts = []
    for _ in range(int(rng.integers(2, 5))):
        r, h = radius * rng.uniform(0.5, 0.85), height * rng.uniform(0.6, 1.0)
        x, y = rng.normal(0, 0.42 * radius, 2)
        tint = color * rng.uniform(0.82, 1.18)
        inner = lump(rng, (0.74 * r, 0.74 * r, 0.46 * h), 0.4 * h, 0.5 * tint, rings=3, sides=6).moved(x, y, 1, 0)
        n = max(6, leaves // 2)
        d = _directions(foliage, n, -0.2)
        at = d * (r, r, 0.56 * h) * foliage.uniform(0.74, 1.16, (n, 1)) + (x, y, 0.42 * h)
        size = (0.15 * r + 0.05) * min(1.0, (80 / leaves) ** 0.42)
        parts += [inner, cards(foliage, at, d, size, tint)]
    return Soup.joined(parts)


def oak(rng: Rng, radius: float, height: float, color: Float64Array, leaves: int) -> Soup:
    """A live oak: short trunk, a broad crown of rounded clumps."""
    bark = np.array([0.09, 0.075, 0.06])
    parts = [_trunk(0.45 * height, 0.06 * radius + 0.08, bark, tuple(rng.normal(0, 0.12 * radius, 2)))]
    clumps = int(rng.integers(8, 13))
    for d in _directions(rng, clumps, -0.25):
        at = d * (0.62 * radius, 0.62 * radius, 0.3 * height) + (0, 0, 0.62 * height)
        r = radius * rng.uniform(0.34, 0.5)
        tint = color * rng.uniform(0.8, 1.2)
        core = lump(rng, (0.82 * r, 0.82 * r, 0.66 * r), 0, 0.6 * tint, rings=4, sides=7)
        out = _directions(rng, leaves // clumps, -0.5)
        skin = cards(rng, out * (r, r, 0.8 * r) * rng.uniform(0.85, 1.1, (len(out), 1)), out, 0.1 * r + 0.04, tint)
        clump = Soup.joined([core, skin])
        parts.append(Soup(clump.triangles + at, clump.colors, clump.normals))
    return Soup.joined(parts)


def conifer(rng: Rng, radius: float, height: float, color: Float64Array, leaves: int) -> Soup:
    """A pine or bigcone fir: a straight trunk and whorls of boughs that droop and shorten upwards, with gaps between
    them."""
    parts = [_trunk(0.97 * height, 0.02 * height, np.array([0.11, 0.08, 0.06]))]
    boughs = max(40, leaves // 26)
    up = np.sort(rng.uniform(0.0, 1.0, boughs) ** 1.15)  # more low down, where they are long
    z = height * (0.13 + 0.86 * up)
    angle = np.arange(boughs) * 2.399963 + rng.uniform(0, 0.9, boughs)
    reach = radius * (1.02 - up) ** 0.85 * rng.uniform(0.62, 1.12, boughs) + 0.12
    sprays = max(6, leaves // boughs)
    t = np.linspace(0.18, 1.0, sprays)[None, :] + rng.uniform(-0.05, 0.05, (boughs, sprays))
    droop = 0.34 * t**1.6 - 0.12 * t
    side = rng.normal(0, 0.16, (boughs, sprays)) * reach[:, None] * (1.15 - t)
    out = reach[:, None] * t
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    at = np.stack([out * c - side * s, out * s + side * c, z[:, None] - droop * reach[:, None]], axis=-1)
    direction = np.broadcast_to(np.stack([c, s, np.full_like(c, -0.25)], axis=-1), at.shape).reshape(
        -1, 3
    ) + 0.35 * rng.normal(size=(at.shape[0] * at.shape[1], 3))
    length = (0.16 * reach[:, None] + 0.16) * rng.uniform(0.7, 1.3, (boughs, sprays))
    outward = np.broadcast_to(np.stack([c, s, np.full_like(c, 0.45)], axis=-1), at.shape).reshape(-1, 3)
    tint = np.repeat(rng.uniform(0.8, 1.2, boughs), sprays) * (0.72 + 0.38 * np.clip(t, 0, 1)).ravel()
    parts.append(_sprays(rng, at.reshape(-1, 3), direction, outward, length.ravel(), color * tint[:, None]))
    inner = lump(rng, (0.26 * radius, 0.26 * radius, 0.4 * height), 0.5 * height, 0.42 * color, rings=5, sides=6)
    taper = np.clip(1.3 - 1.25 * inner.triangles[..., 2:] / height, 0.05, 1.0)
    flat = np.concatenate([taper, taper, np.ones_like(taper)], axis=-1)
    parts.append(Soup(inner.triangles * flat, inner.colors, inner.normals))
    return Soup.joined(parts)


def _sprays(
    rng: Rng,
    foot: Float64Array,
    direction: Float64Array,
    outward: Float64Array,
    length: Float64Array,
    colors: Float64Array,
) -> Soup:
    """Needle sprays: a slender kite of two triangles from each foot along `direction`, shaded by `outward`."""
    along = _unit(direction)
    across = _unit(np.cross(along, rng.normal(size=along.shape))) * (0.3 * length)[:, None]
    tip = foot + along * length[:, None]
    middle = foot + 0.45 * along * length[:, None]
    a, b = middle + across, middle - across
    triangles = np.concatenate([np.stack([foot, a, tip], axis=1), np.stack([foot, tip, b], axis=1)])
    tint = np.clip(colors * (1 + 0.14 * rng.normal(size=(len(foot), 1))), 0.004, 0.9)
    shade = _unit(outward + 0.25 * rng.normal(size=outward.shape))
    return Soup(triangles, np.concatenate([tint, tint]), np.concatenate([shade, shade]))


def tuft(rng: Rng, radius: float, height: float, color: Float64Array, blades: int, width: float = 0.03) -> Soup:
    """A grass tuft: thin blades from a common foot, bent outwards; pale tips."""
    angle = rng.uniform(0, 2 * np.pi, blades)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    foot = 0.4 * radius * rng.normal(size=(blades, 2))
    tall = height * rng.uniform(0.5, 1.1, blades)
    side = width * np.stack([-out[:, 1], out[:, 0]], axis=1)
    top = foot + out * radius * rng.uniform(0.3, 1.0, (blades, 1))
    flat = np.zeros((blades, 1))
    a, b = np.hstack([foot - side, flat]), np.hstack([foot + side, flat])
    triangles = np.stack([a, b, np.hstack([top, tall[:, None]])], axis=1)
    tint = color * (1 + 0.15 * rng.normal(size=(blades, 1)))
    normals = _unit(np.hstack([0.35 * out, np.ones((blades, 1))]))
    return Soup(triangles, np.clip(tint, 0.01, 0.9), normals)


def scorched(soup: Soup, share: float, color: Float64Array) -> Soup:
    """Foliage below the share `share` of the plant's height browned to `color`; trunks and the inside stay dark."""
    if share <= 0:
        return soup
    z = soup.triangles[..., 2].mean(axis=1)
    leaf = soup.colors[:, 1] > soup.colors[:, 0]
    dead = leaf & (z < share * float(soup.triangles[..., 2].max()))
    brightness = soup.colors.mean(axis=1, keepdims=True) / max(float(soup.colors[leaf].mean()), 1e-6)
    colors = np.where(dead[:, None], np.clip(color * brightness, 0.005, 0.9), soup.colors)
    return Soup(soup.triangles, colors, soup.normals)


def _rod(foot: Float64Array, top: Float64Array, radius: float, color: Float64Array) -> Soup:
    """A three-sided rod that tapers to a third."""
    axis = top - foot
    side = np.cross(axis, (0.31, 0.85, 0.42))
    side /= max(float(np.linalg.norm(side)), 1e-9)
    other = np.cross(axis, side) / max(float(np.linalg.norm(axis)), 1e-9)
    angle = np.arange(3) * 2 * np.pi / 3
    ring = radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other)
    a, b = foot + ring, top + ring / 3
    nxt = [1, 2, 0]
    triangles = np.concatenate([np.stack([a, a[nxt], b[nxt]], axis=1), np.stack([a, b[nxt], b], axis=1)])
    return Soup(triangles, np.broadcast_to(color, (len(triangles), 3)).copy(), _faces(triangles))


def stems(rng: Rng, radius: float, height: float, color: Float64Array, count: int) -> Soup:
    """The bare charred stems of a burnt shrub, spreading from one foot."""
    parts = []
    for _ in range(count):
        angle, lean = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.0) * radius
        top = np.array([lean * np.cos(angle), lean * np.sin(angle), height * rng.uniform(0.5, 1.0)])
        parts.append(_rod(np.array([0.0, 0.0, -0.2]), top, 0.035, color * rng.uniform(0.7, 2.5)))
    return Soup.joined(parts)


def snag(rng: Rng, height: float, color: Float64Array, boughs: int = 14) -> Soup:
    """A tree that fire has killed: a black trunk with the stubs of its boughs."""
    lean = rng.normal(0, 0.03 * height, 2)
    parts = [_trunk(height, 0.03 * height, color * 1.6, (float(lean[0]), float(lean[1])))]
    for _ in range(boughs):
        z = height * rng.uniform(0.25, 0.97)
        angle, reach = rng.uniform(0, 2 * np.pi), (1.15 - z / height) * rng.uniform(0.5, 2.6)
        foot = np.array([lean[0] * z / height, lean[1] * z / height, z])
        tip = foot + np.array([reach * np.cos(angle), reach * np.sin(angle), reach * rng.uniform(0.1, 0.7)])
        parts.append(_rod(foot, tip, 0.012 * height * (1.2 - z / height) + 0.02, color * rng.uniform(0.8, 2.2)))
    return Soup.joined(parts)


def house(rng: Rng) -> Soup:
    """A house with a gable roof, dark windows and a foundation that reaches down into the slope."""
    length, width, eaves = rng.uniform(10, 17), rng.uniform(7.5, 10), rng.uniform(2.7, 5.4)
    ridge = eaves + width * rng.uniform(0.18, 0.32)
    wall = np.array([0.52, 0.47, 0.4]) * rng.uniform(0.6, 1.3)
    roofs = ([0.23, 0.1, 0.065], [0.19, 0.17, 0.16], [0.33, 0.31, 0.29], [0.12, 0.115, 0.11])
    roof = np.array(roofs[int(rng.integers(len(roofs)))]) * rng.uniform(0.8, 1.2)
    a, b, over = length / 2, width / 2, 0.45
    quads: list[tuple[list[tuple[float, float, float]], Float64Array]] = []
    corners = [(-a, -b), (a, -b), (a, b), (-a, b)]
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        quads.append(([(x0, y0, -2.5), (x1, y1, -2.5), (x1, y1, eaves), (x0, y0, eaves)], wall))
        out = np.array([y1 - y0, x0 - x1]) / np.hypot(x1 - x0, y1 - y0) * 0.03
        for t in np.arange(0.12, 0.85, 0.24):
            px, py = x0 + (x1 - x0) * t + out[0], y0 + (y1 - y0) * t + out[1]
            qx, qy = x0 + (x1 - x0) * (t + 0.11) + out[0], y0 + (y1 - y0) * (t + 0.11) + out[1]
            quads.append(([(px, py, 0.9), (qx, qy, 0.9), (qx, qy, 2.1), (px, py, 2.1)], np.array([0.04, 0.045, 0.05])))
    drop = over * (ridge - eaves) / b
    for s in (-1.0, 1.0):
        y = s * (b + over)
        slope = [(-a - over, y, eaves - drop), (a + over, y, eaves - drop), (a + over, 0, ridge), (-a - over, 0, ridge)]
        quads.append((slope, roof))
    triangles, colors = [], []
    for q, color in quads:
        p = np.array(q, np.float64)
        triangles += [p[[0, 1, 2]], p[[0, 2, 3]]]
        colors += [color, color]
    for s in (-1.0, 1.0):
        triangles.append(np.array([(s * a, -b, eaves), (s * a, b, eaves), (s * a, 0, ridge - 0.02)]))
        colors.append(wall)
    soup = np.array(triangles)
    return Soup(soup, np.clip(np.array(colors), 0.01, 0.9), _faces(soup))
