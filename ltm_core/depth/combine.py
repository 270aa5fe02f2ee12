"""Terrain or network, pixel by pixel.

If the terrain were right, what would the network say here, and how surely (`answers`)? Where it says that, both are
averaged by inverse variance, in inverse depth: far away the terrain decides, since a network's sigma grows with the
square of the depth. Where it says something else, either something stands before the terrain, or it is gone, or the
network is wrong; the chance of each, by the class that the label gives, decides whether the network alone is taken.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.answers import meant, said

Image = NDArray[np.float32]
Bytes = NDArray[np.uint8]

VANISHED = 0.01
"""Chance that the ground of a pixel is gone, so that something farther shows."""
FOOTLESS, FOOTLESS_CHANCE = 1.5, 0.02
"""What the network sees nearer than all ground below it in the photo by this factor has no foot that it stands on, and
so much less chance."""
_SOFT = 0.25  # of the range of a network's depth among neighbours: how far a pixel between them may be off
_RANGES = 3.0  # e-foldings of depth over which something that stands before the terrain may be, each as likely


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def combine(
    depth: Image,
    sigma: Image,
    over: Image,
    has_over: bool,
    inverse: Image,
    nearest: Image,
    farthest: Image,
    shift: Image,
    factor: Image,
    gross: np.float32,
    usable: bool,
    labels: Bytes,
    labelled: bool,
    sky: int,
    standing: NDArray[np.float32],
    prefers_over: NDArray[np.float32],
    source: Bytes,
) -> None:
    """Fuse in place: `depth` and `sigma` (H, W) come in as the terrain's and go out as the fused ones, `source` as
    `fusion.Source`.

    `over`: depth of a canopy raster. `inverse`, `nearest`, `farthest`: see `seen.SeenDepth`; `shift`, `factor`: see
    `answers.Answers`; `gross`: see `NetworkFit`. `standing`, `prefers_over`: (256,) `DepthClasses.standing`,
    `.surface`.
    What is absent, as `has_over`, `usable` and `labelled` say, is of size (1, 1).
    """
    far = np.float32(1e9)
    one, half = np.float32(1.0), np.float32(0.5)
    height, width = depth.shape
    rows, cols = shift.shape[0], shift.shape[1]
    foot = np.full(width, np.float32(np.inf))
    for v in range(height - 1, -1, -1):
        i = v * rows // height
        for u in range(width):
            j = u * cols // width
            d, s = depth[v, u], sigma[v, u]
            label = labels[v, u] if labelled else np.uint8(255)
            y, near, back = np.float32(np.nan), one, one
            if usable:
                y, near, back = inverse[v, u], nearest[v, u], farthest[v, u]
            if has_over:
                c = over[v, u]
                if c < far and (not d < far or abs(c - d) > s):
                    # Bare ground or canopy: the label's odds, and which of the two the network is nearer to.
                    odds = prefers_over[label]
                    if y == y:
                        a = np.float32(0.0)
                        if d < far:
                            a = one / d
                        m, t = said(i, j, a, shift, factor)
                        to_ground = (y - a + m) / t
                        odds += half * to_ground * to_ground + np.log(t)
                        m, t = said(i, j, one / c, shift, factor)
                        to_over = (y - one / c + m) / t
                        odds -= half * to_over * to_over + np.log(t)
                        odds = min(
                            max(odds, prefers_over[label] - np.float32(4.0)), prefers_over[label] + np.float32(4.0)
                        )
                    if odds > 0:
                        s = np.float32(0.03) * c if np.isnan(s) else max(s, np.float32(0.01) * c)
                        d = c
            ground = d < far
            if d < foot[u]:
                foot[u] = d
            # The terrain's inverse depth and variance: 0 for sky.
            a, b = np.float32(0.0), np.float32(0.0)
            source[v, u] = 4 if d > far else 0
            if ground:
                a, b = one / d, s / (d * d)
                source[v, u] = 1
            else:
                s = np.float32(np.nan)
            if y == y and (ground or label != sky):
                m, t = said(i, j, a, shift, factor)
                # At an edge the network's depth is the other side's in part.
                soft = np.float32(_SOFT) * (near - back)
                joint = t * t + b * b + soft * soft
                off = y - a + m
                alone = False
                other = y
                if np.isnan(d):
                    alone = label != sky
                elif off * off > np.float32(2.0) * joint and label != sky and (off > 0 or ground):
                    # Something stands there? At a soft edge only where the network is nearer to the near side. Or is
                    # something gone? That is not asked at edges, where the far side, or sky, may have leaked in.
                    other = near if off > 0 else y
                    edge = near - y if off > 0 else near - back
                    if edge < abs(off):
                        fits = np.exp(-half * off * off / joint) / np.sqrt(np.float32(2 * np.pi) * joint)
                        chance = standing[label] if off > 0 else np.float32(VANISHED)
                        if off > 0 and other * foot[u] > np.float32(FOOTLESS):
                            chance *= np.float32(FOOTLESS_CHANCE)
                        spread = one / (np.float32(_RANGES) * max(other, t))
                        alone = chance * spread > (one - chance) * ((one - gross) * fits + gross * spread)
                if alone:
                    other, w = meant(i, j, other, shift, factor)
                    alone = w < other and (np.isnan(d) or (other > a) == (off > 0))
                    if alone:
                        d, s = one / other, w / (other * other)
                        source[v, u] = 2
                if ground and not alone:
                    w = b * b / joint
                    if off * off <= np.float32(9.0) * joint and a + w * off > half * a:
                        d = one / (a + w * off)
                        s = b * np.sqrt(one - w) * d * d
                        if w > np.float32(0.1):
                            source[v, u] = 3
            depth[v, u], sigma[v, u] = d, s
