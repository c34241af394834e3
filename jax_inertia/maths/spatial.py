"""Six-dimensional algebra, and the one table of conventions that everything else follows.

| quantity | convention |
|---|---|
| units | SI: m, kg, s, rad, N, N m |
| q, v | MuJoCo's order; free joint: position, quaternion wxyz; linear velocity world, angular velocity body |
| spatial motion | [angular; linear], world axes, at the tree's origin |
| spatial force | [moment; force], world axes, about the tree's origin |
| wrench in a log | [force; moment], world axes, moment about the named body's frame origin |
| pi | [m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] about the body's frame origin, in the body frame |

The *tree's origin* is the position of its free joint (the world's origin where the base is fixed): the dynamics
do not depend on where in the world a robot stands, and leaving the translation out keeps float32 accurate a
hundred metres from home.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def cross(a: Float[Array, "*#b 3"], b: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """Cross product a × b along the last axis, written out so that XLA fuses it."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def skew(a: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Matrix [a]× with [a]× b = a × b."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    zero = jnp.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def motion_cross(v: Float[Array, "*b 6"], m: Float[Array, "*b 6"]) -> Float[Array, "*b 6"]:
    """Rate of change v × m of a motion vector m that moves with velocity v (Featherstone 2008, eq. 2.31)."""
    w, u = v[..., :3], v[..., 3:]
    return jnp.concatenate(
        [cross(w, m[..., :3]), cross(w, m[..., 3:]) + cross(u, m[..., :3])], axis=-1
    )


def matvec(m: Float[Array, "*b i j"], x: Float[Array, "*b j"]) -> Float[Array, "*b i"]:
    """m x for small matrices, as multiplies and adds that XLA fuses (a batched 3×3 `dot` does not)."""
    return jnp.sum(m * x[..., None, :], axis=-1)


def matmul(a: Float[Array, "*b i j"], b: Float[Array, "*b j k"]) -> Float[Array, "*b i k"]:
    """a b for small matrices, fused like `matvec`."""
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def cholesky(m: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """Lower factor of small positive matrices, fused like `matvec`; NaN where a matrix is not positive.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.spatial import cholesky
    >>> cholesky(jnp.array([[4.0, 2.0], [2.0, 10.0]]))
    Array([[2., 0.],
           [1., 3.]], dtype=float64)
    """
    n = m.shape[-1]
    rows: list[list[Array]] = []
    for i in range(n):
        row: list[Array] = []
        for j in range(i + 1):
            earlier = row if i == j else rows[j]
            left = m[..., i, j] - sum(a * b for a, b in zip(row, earlier, strict=False))
            root = jnp.sqrt(jnp.where(left > 0, left, jnp.nan)) if i == j else left / earlier[j]
            row.append(root)
        rows.append(row)
    zero = jnp.zeros_like(m[..., 0, 0])
    filled = [jnp.stack(row + [zero] * (n - len(row)), axis=-1) for row in rows]
    return jnp.stack(filled, axis=-2)


def quat_to_matrix(quat: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix (child to parent) of a quaternion wxyz of any non-zero length."""
    quat = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
    w, x, y, z = (quat[..., i] for i in range(4))
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def axis_angle_to_matrix(
    axis: Float[Array, "*b 3"], angle: Float[Array, "*b"]
) -> Float[Array, "*b 3 3"]:
    """Rotation by `angle` [rad] about a unit axis: 1 + sin [a]× + (1 − cos) [a]×² (Rodrigues)."""
    k = skew(axis)
    # 2 sin²(angle/2) rather than 1 − cos: no cancellation near zero in float32.
    versine = 2.0 * jnp.sin(0.5 * angle) ** 2
    return (
        jnp.eye(3, dtype=axis.dtype)
        + jnp.sin(angle)[..., None, None] * k
        + versine[..., None, None] * matmul(k, k)
    )
