"""The renderer: homogeneous rasterisation with a z-buffer, then one texture look-up per pixel and visible face.

A pixel's ray d = K^-1 (x, y, 1) meets the face origin + a u + b v at depth z where d = (a u + b v + origin) / z in
camera coordinates. With M = [u v origin], M^-1 d = (a, b, 1) / z: three functions that are affine in the pixel's
position. The face covers the pixel where 0 <= a/z <= 1/z and 0 <= b/z <= 1/z, so that no clipping is needed (Olano and
Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997).

Edges are anti-aliased by four samples per pixel on a rotated grid; texture is filtered by mip levels instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit
from airline.scenes.builder import Array, Scene
from airline.scenes.textures import LEVELS, SIZE, STRIDE

NEAR = 0.05  # m
BAND = 32  # rows
SAMPLES = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]])


def to_camera(vectors: Array, rotation: Array, translation: Array | float = 0.0) -> Array:
    """World vectors (..., 3) in camera coordinates; every element is computed alike, whatever the array's shape."""
    x, y, z = np.moveaxis(vectors, -1, 0)[..., None]
    return np.asarray(translation + rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z)


def project_faces(
    scene: Scene, rotation: Array, translation: Array, focal: float, centre: Array, size: tuple[int, int]
) -> tuple[NDArray[np.intp], Array, Array, Array]:
    """Faces that look at the camera and may touch the image of a (width, height).

    Returns (M,) rows, (M, 3, 3) M^-1 in camera coordinates, (M, 4) bounds x0, y0, x1, y1, px, (M,) nearest depths, m.
    """
    o, u, v = to_camera(scene.origins, rotation, translation), *(to_camera(a, rotation) for a in (scene.u, scene.v))
    normal = np.cross(u, v)
    det = normal[:, 0] * o[:, 0] + normal[:, 1] * o[:, 1] + normal[:, 2] * o[:, 2]
    corners = np.stack([o, o + u, o + v, o + u + v], axis=1)
    z = corners[..., 2:]
    near, far = z.min(axis=(1, 2)), z.max(axis=(1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = focal * corners[..., :2] / z + centre
    low = np.where(z > NEAR, pixels, 1e9).min(axis=1)
    high = np.where(z > NEAR, pixels, -1e9).max(axis=1)
    low[near <= NEAR], high[near <= NEAR] = -1, size
    inside = (high >= -0.5).all(axis=1) & (low <= np.array(size) - 0.5).all(axis=1)
    faces = np.nonzero((det <= -1e-9) & (far > NEAR) & inside)[0]
    o, u, v = o[faces], u[faces], v[faces]
    inverse = np.stack([np.cross(v, o), np.cross(o, u), normal[faces]], axis=1) / det[faces, None, None]
    return faces, inverse, np.concatenate([low, high], axis=1)[faces], np.maximum(near, NEAR)[faces]


def pixel_functions(inverse: Array, focal: float, centre: Array) -> Array:
    """(M, 3, 3) float64: a/z, b/z and 1/z of each face as c0 x + c1 y + c2 of the pixel's position."""
    c0, c1, c2 = np.moveaxis(inverse, -1, 0)
    return np.stack([c0 / focal, c1 / focal, c2 - (c0 * centre[0] + c1 * centre[1]) / focal], axis=-1)


@njit()
def _rasterize(functions, bounds, samples, first_row, columns, nearest, index):  # type: ignore[no-untyped-def]
    """Row of `functions` of the nearest face at every sample of a band of rows, into index (S, B, W) int32; else -1.

    `nearest` (S, B, W) float32 is the z-buffer of inverse depths.
    """
    count, rows, width = nearest.shape
    nearest[:] = 0
    index[:] = -1
    slope, base = np.empty(4), np.empty(4)
    lower = np.empty(4, np.bool_)
    for f in range(functions.shape[0]):
        top = max(first_row, int(np.floor(bounds[f, 1])))
        bottom = min(first_row + rows - 1, int(np.ceil(bounds[f, 3])))
        if top > bottom:
            continue
        g = functions[f]
        for k in range(4):
            c0, c1, c2 = g[k // 2, 0], g[k // 2, 1], g[k // 2, 2]
            if k % 2 == 1:
                c0, c1, c2 = g[2, 0] - c0, g[2, 1] - c1, g[2, 2] - c2
            if abs(c0) < 1e-12:
                c0 = 1e-12
            slope[k], base[k], lower[k] = -c1 / c0, -c2 / c0, c0 > 0
        for s in range(count):
            dx, dy = samples[s, 0], samples[s, 1]
            for y in range(top, bottom + 1):
                low, high = 0.0, width - 1.0
                for k in range(4):
                    x = slope[k] * (y + dy) + base[k] - dx
                    if lower[k]:
                        low = max(low, x)
                    else:
                        high = min(high, x)
                start, stop = int(np.ceil(low)), int(np.floor(high)) + 1
                if start < stop:
                    near, face = nearest[s, y - first_row, start:stop], index[s, y - first_row, start:stop]
                    constant = np.float32(g[2, 0] * dx + g[2, 1] * (y + dy) + g[2, 2])
                    _fill(near, face, columns[start:stop], np.float32(g[2, 0]), constant, np.int32(f))


@njit()
def _fill(nearest, index, columns, slope, constant, face):  # type: ignore[no-untyped-def]
    """Z-buffer one span; written without branches so that it compiles to SIMD instructions."""
    for k in range(len(nearest)):
        w = slope * columns[k] + constant
        closer = w > nearest[k]
        nearest[k] = w if closer else nearest[k]
        index[k] = face if closer else index[k]


@njit(inline="always")
def _texel(bank, start, size, s, t):  # type: ignore[no-untyped-def]
    """Bilinear look-up at tile coordinates (s, t) in a seamless level of size x size px."""
    scale = np.float32(size)
    x, y = s * scale - np.float32(0.5), t * scale - np.float32(0.5)
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = x - fx, y - fy
    mask = np.uint32(size - 1)
    x0, y0 = np.uint32(np.int32(fx)) & mask, np.uint32(np.int32(fy)) & mask
    x1, y1 = (x0 + np.uint32(1)) & mask, (y0 + np.uint32(1)) & mask
    upper, lower = np.uint32(start) + y0 * np.uint32(size), np.uint32(start) + y1 * np.uint32(size)
    a, b = np.float32(bank[upper + x0]), np.float32(bank[upper + x1])
    c, d = np.float32(bank[lower + x0]), np.float32(bank[lower + x1])
    a += ax * (b - a)
    c += ax * (d - c)
    return a + ay * (c - a)


@njit()
def _shade_span(functions, material, texture, bank, f, start, stop, x_offset, y, weight, out):  # type: ignore[no-untyped-def]
    """Add `weight` times the light of face f to the pixels start..stop-1 of a row `out` (W, 3).

    The texture's mip level is found once per 8 px: it changes slowly, and its logarithm is dear.
    """
    u0, v0, w0 = functions[f, 0, 0], functions[f, 1, 0], functions[f, 2, 0]
    uy, vy, wy = functions[f, 0, 1], functions[f, 1, 1], functions[f, 2, 1]
    uc, vc, wc = uy * y + functions[f, 0, 2], vy * y + functions[f, 1, 2], wy * y + functions[f, 2, 2]
    m0, m1, m2, m3 = material[f, 0], material[f, 1], material[f, 2], material[f, 3]
    shade0, shade1, shade2 = weight * material[f, 4], weight * material[f, 5], weight * material[f, 6]
    low0, low1, low2 = material[f, 7], material[f, 8], material[f, 9]
    range0, range1, range2 = material[f, 10], material[f, 11], material[f, 12]
    first = texture[f] * STRIDE
    for block in range(start, stop, 8):
        x = block + x_offset
        z = 1.0 / (w0 * x + wc)
        a, b = (u0 * x + uc) * z, (v0 * x + vc) * z
        ax, ay = (u0 - a * w0) * m1, (uy - a * wy) * m1
        bx, by = (v0 - b * w0) * m3, (vy - b * wy) * m3
        footprint = max(ax * ax + bx * bx, ay * ay + by * by) * z * z * (SIZE * SIZE)
        level = np.float32(min(0.5 * np.log2(max(footprint, 1.0)), LEVELS - 1.001))
        fine = int(level)
        blend = level - np.float32(fine)
        size = SIZE >> fine
        offset = first + (4 * (SIZE * SIZE - size * size)) // 3
        for column in range(block, min(block + 8, stop)):
            x = column + x_offset
            z = 1.0 / (w0 * x + wc)
            a32, b32 = np.float32((u0 * x + uc) * z), np.float32((v0 * x + vc) * z)
            s, t = m0 + m1 * a32, m2 + m3 * b32
            value = _texel(bank, offset, size, s, t)
            if blend > 0:
                value += blend * (_texel(bank, offset + size * size, size >> 1, s, t) - value)
            light = shade0 + shade1 * a32 + shade2 * b32
            out[column, 0] += light * (low0 + value * range0)
            out[column, 1] += light * (low1 + value * range1)
            out[column, 2] += light * (low2 + value * range2)


@njit()
def draw(functions, bounds, samples, material, texture, bank, sky_map, sky, width, height):  # type: ignore[no-untyped-def]
    """(H, W, 3) float32 linear BGR and (H, W) float32 depth in m (inf: sky), in bands of rows that stay in the cache.

    Args:
        functions, bounds: (M, 3, 3) and (M, 4) of the faces in view; samples: (S, 2) offsets in a pixel, px.
        material: (M, 13) float32 rows of `Scene.materials`; texture: (M,) int32; bank: (T * STRIDE,) uint8.
        sky_map: (3,) height c0 x + c1 y + c2 of a pixel's ray above the horizon; sky: (2, 3) float32 colours.
    """
    image = np.zeros((height, width, 3), np.float32)
    depth = np.empty((height, width), np.float32)
    columns = np.arange(width).astype(np.float32)
    nearest = np.empty((len(samples), BAND, width), np.float32)
    index = np.empty((len(samples), BAND, width), np.int32)
    mixed = np.empty(width, np.bool_)
    for top in range(0, height, BAND):
        rows = min(BAND, height - top)
        _rasterize(functions, bounds, samples, top, columns, nearest[:, :rows], index[:, :rows])
        for k in range(rows):
            y, line = top + k, index[:, k]
            mixed[:] = False
            for s in range(1, len(samples)):
                for x in range(width):
                    mixed[x] |= line[s, x] != line[0, x]
            x = 0
            while x < width:
                if mixed[x]:
                    _blend_pixel(
                        functions, material, texture, bank, samples, line[:, x], (sky_map, sky), x, y, image[y], depth
                    )
                    x += 1
                    continue
                start, f = x, line[0, x]
                while x < width and not mixed[x] and line[0, x] == f:
                    x += 1
                if f < 0:
                    _add_sky(sky_map, sky, start, x, y, np.float32(1), image[y])
                    depth[y, start:x] = np.inf
                    continue
                _shade_span(functions, material, texture, bank, f, start, x, 0.0, float(y), np.float32(1), image[y])
                for c in range(start, x):
                    depth[y, c] = 1 / (functions[f, 2, 0] * c + functions[f, 2, 1] * y + functions[f, 2, 2])
    return image, depth


@njit()
def _blend_pixel(functions, material, texture, bank, samples, faces, sky, x, y, out, depth):  # type: ignore[no-untyped-def]
    """A pixel whose samples see several `faces` (S,), which are overwritten; its depth is that of the nearest."""
    nearest = 0.0
    for s in range(len(faces)):
        f = faces[s]
        if f == -2:
            continue
        weight = np.float32(0)
        for r in range(s, len(faces)):
            if faces[r] == f:
                weight += np.float32(1 / len(faces))
                faces[r] = -2
        if f < 0:
            _add_sky(sky[0], sky[1], x, x + 1, y, weight, out)
            continue
        dx, sample_y = samples[s, 0], y + samples[s, 1]
        _shade_span(functions, material, texture, bank, f, x, x + 1, dx, sample_y, weight, out)
        w = functions[f, 2, 0] * x + functions[f, 2, 1] * y + functions[f, 2, 2]
        if w <= 0:
            w = functions[f, 2, 0] * (x + dx) + functions[f, 2, 1] * sample_y + functions[f, 2, 2]
        nearest = max(nearest, w)
    depth[y, x] = 1 / nearest


@njit()
def _add_sky(sky_map, sky, start, stop, y, weight, out):  # type: ignore[no-untyped-def]
    for x in range(start, stop):
        rise = np.float32(min(max(sky_map[0] * x + sky_map[1] * y + sky_map[2], 0.0), 1.0))
        for c in range(3):
            out[x, c] += weight * (sky[0, c] + rise * (sky[1, c] - sky[0, c]))


def sky_function(world_from_camera: Array, focal: float, centre: Array) -> Array:
    """(3,) float64: twice the height of a pixel's ray (z = 1) above the horizon, as c0 x + c1 y + c2."""
    up = 2 * world_from_camera[2, :3]
    return np.array([up[0] / focal, up[1] / focal, up[2] - (up[0] * centre[0] + up[1] * centre[1]) / focal])
