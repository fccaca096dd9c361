"""Short names of the common vector and matrix types: ``vec3f``, ``mat2x3i``; f, d, i and b as in the paper."""

from __future__ import annotations

from ebb.types.types import bool_, float32, float64, int32, matrix, vector

vec2f, vec3f, vec4f = (vector(float32, n) for n in (2, 3, 4))
vec2d, vec3d, vec4d = (vector(float64, n) for n in (2, 3, 4))
vec2i, vec3i, vec4i = (vector(int32, n) for n in (2, 3, 4))
vec2b, vec3b, vec4b = (vector(bool_, n) for n in (2, 3, 4))

mat2f, mat3f, mat4f = (matrix(float32, n, n) for n in (2, 3, 4))
mat2d, mat3d, mat4d = (matrix(float64, n, n) for n in (2, 3, 4))
mat2i, mat3i, mat4i = (matrix(int32, n, n) for n in (2, 3, 4))
mat2b, mat3b, mat4b = (matrix(bool_, n, n) for n in (2, 3, 4))

mat2x3f, mat2x4f, mat3x2f, mat3x4f, mat4x2f, mat4x3f = (
    matrix(float32, r, c) for r, c in ((2, 3), (2, 4), (3, 2), (3, 4), (4, 2), (4, 3))
)
mat2x3d, mat2x4d, mat3x2d, mat3x4d, mat4x2d, mat4x3d = (
    matrix(float64, r, c) for r, c in ((2, 3), (2, 4), (3, 2), (3, 4), (4, 2), (4, 3))
)
mat2x3i, mat2x4i, mat3x2i, mat3x4i, mat4x2i, mat4x3i = (
    matrix(int32, r, c) for r, c in ((2, 3), (2, 4), (3, 2), (3, 4), (4, 2), (4, 3))
)
mat2x3b, mat2x4b, mat3x2b, mat3x4b, mat4x2b, mat4x3b = (
    matrix(bool_, r, c) for r, c in ((2, 3), (2, 4), (3, 2), (3, 4), (4, 2), (4, 3))
)
