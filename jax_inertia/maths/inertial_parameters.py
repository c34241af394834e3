"""Inertial parameters of one rigid body: π, its pseudo-inertia, and the log-Cholesky maps.

A body is physical (fully physically consistent: Traversaro et al. 2016) exactly when its 4×4 pseudo-inertia

    P = [[Σ, h], [hᵀ, m]],   Σ = ½ tr(I) 1 − I

is positive definite: positive mass, positive-definite rotational inertia about the centre of mass, and the
triangle inequalities of its principal moments, all at once (Wensing et al. 2018). Writing P by its Cholesky factor
makes every θ in R¹⁰ a physical body. Two factors are in use and are not interchangeable:

    paper (Rucker and Wensing 2022; Foster et al., eq. log-cholesky)    P = UᵀU,   m = e^{2α} (t·t + 1)
    Pinocchio, MuJoCo's sysid, later IHMC code                          P = U Uᵀ,  m = e^{2α}, t = centre of mass

with one and the same upper-triangular

    U = e^α [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]].
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jax_inertia.maths import spatial
from jax_inertia.maths.argument_checks import last_axes
from jax_inertia.maths.precision import in_full_precision

PI_NAMES = ("m", "hx", "hy", "hz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
THETA_NAMES = ("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3")
_ORDER = {"pi": ", ".join(PI_NAMES), "theta": ", ".join(THETA_NAMES)}


def _ten(name: str, values: Float[Array, "*b 10"]) -> list[Float[Array, "*b"]]:
    """The ten numbers of π or θ, batched; JAX alone would take the last of fewer twice."""
    array = last_axes(name, values, (10,), _ORDER[name])
    return [array[..., i] for i in range(10)]


def rotational_inertia(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 3 3"]:
    """Rotational inertia I [kg m²] about the frame origin, as a symmetric matrix.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, rotational_inertia
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> rotational_inertia(pi).diagonal()
    Array([0.04, 0.04, 0.01], dtype=float64)
    """
    _, _, _, _, xx, xy, xz, yy, yz, zz = _ten("pi", pi)
    rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def centre_of_mass(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 3"]:
    """Centre of mass h/m [m] in the body frame; zero for a massless body.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import centre_of_mass, from_com
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> centre_of_mass(pi)
    Array([0. , 0. , 0.1], dtype=float64)
    """
    return _centre_of_mass(pi)


# Called with numbers, each of its operations would be compiled for itself.
@jax.jit
def _centre_of_mass(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 3"]:
    m = pi[..., :1]
    return jnp.where(m == 0, 0.0, pi[..., 1:4] / jnp.where(m == 0, 1.0, m))


def from_com(
    mass: Float[Array, "*b"], com: Float[Array, "*b 3"], inertia: Float[Array, "*b 3 3"]
) -> Float[Array, "*b 10"]:
    """π of a body of `mass` [kg], centre of mass `com` [m] and `inertia` [kg m²] *about the centre of mass*.

    Parallel-axis theorem: I = I_c + m (c·c 1 − c cᵀ); h = m c. Raises ValueError for a `com` or an `inertia` of another
    shape: principal moments alone go in as `jnp.diag(moments)`.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> pi  # 2 kg · (0.1 m)² more about the frame's origin
    Array([2.  , 0.  , 0.  , 0.2 , 0.04, 0.  , 0.  , 0.04, 0.  , 0.01],      dtype=float64)
    """
    mass = jnp.asarray(mass)
    com = last_axes("com", com, (3,), "x, y, z in metres")
    inertia = last_axes("inertia", inertia, (3, 3), "a matrix: principal moments go in as jnp.diag")
    shift = jnp.sum(com * com, -1)[..., None, None] * jnp.eye(3, dtype=com.dtype)
    shift = shift - com[..., :, None] * com[..., None, :]
    i = inertia + mass[..., None, None] * shift
    return jnp.stack(
        [
            mass,
            *(mass * com[..., k] for k in range(3)),
            i[..., 0, 0],
            i[..., 0, 1],
            i[..., 0, 2],
            i[..., 1, 1],
            i[..., 1, 2],
            i[..., 2, 2],
        ],
        axis=-1,
    )


def pseudo_inertia(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 4 4"]:
    """Pseudo-inertia P = [[½ tr(I) 1 − I, h], [hᵀ, m]] (Wensing et al. 2018, eq. 12).

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, pseudo_inertia
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> pseudo_inertia(pi).diagonal()
    Array([0.005, 0.005, 0.035, 2.   ], dtype=float64)
    """
    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = _ten("pi", pi)
    rows = [
        [0.5 * (yy + zz - xx), -xy, -xz, hx],
        [-xy, 0.5 * (xx + zz - yy), -yz, hy],
        [-xz, -yz, 0.5 * (xx + yy - zz), hz],
        [hx, hy, hz, m],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def from_pseudo_inertia(p: Float[Array, "*b 4 4"]) -> Float[Array, "*b 10"]:
    """π of a pseudo-inertia: I = tr(Σ) 1 − Σ, the inverse of `pseudo_inertia`.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_pseudo_inertia, pseudo_inertia
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> bool(jnp.allclose(from_pseudo_inertia(pseudo_inertia(pi)), pi))
    True
    """
    sx, sy, sz = p[..., 0, 0], p[..., 1, 1], p[..., 2, 2]
    return jnp.stack(
        [
            p[..., 3, 3],
            p[..., 0, 3],
            p[..., 1, 3],
            p[..., 2, 3],
            sy + sz,
            -p[..., 0, 1],
            -p[..., 0, 2],
            sx + sz,
            -p[..., 1, 2],
            sx + sy,
        ],
        axis=-1,
    )


def is_physical(pi: Float[Array, "*b 10"]) -> Bool[Array, "*b"]:
    """Whether the pseudo-inertia is positive definite: m > 0, I_c ≻ 0 and the triangle inequalities.

    Tested by Cholesky, whose success depends on no unit: its errors are those of the matrix whose diagonal is scaled to
    one (Demmel, LAPACK Working Note 14, 1989). So it holds in float32 for bodies of ordinary proportions.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, is_physical
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> bool(is_physical(pi)), bool(is_physical(pi.at[0].set(-1.0)))
    (True, False)
    """
    return _is_physical(pi)


@jax.jit
def _is_physical(pi: Float[Array, "*b 10"]) -> Bool[Array, "*b"]:
    factor = spatial.cholesky(pseudo_inertia(pi))
    return jnp.all(jnp.isfinite(factor), axis=(-2, -1)) & jnp.all(jnp.isfinite(pi), axis=-1)


# --- the paper's factor: P = UᵀU ---------------------------------------------------------------------------------


def from_log_cholesky(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
    """π = g(θ) with pseudo-inertia UᵀU (Foster et al., eq. log-cholesky); physical for every finite θ.

    θ = [α, d1, d2, d3, s12, s13, s23, t1, t2, t3].

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_log_cholesky, is_physical
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> bool(is_physical(from_log_cholesky(jnp.array([0.3, -2, -2, -1, 0.1, 0, 0, 0, 0, 0.2]))))
    True
    """
    a, d1, d2, d3, s12, s13, s23, t1, t2, t3 = _ten("theta", theta)
    e1, e2, e3 = jnp.exp(d1), jnp.exp(d2), jnp.exp(d3)
    terms = [
        t1 * t1 + t2 * t2 + t3 * t3 + 1.0,
        t1 * e1,
        t1 * s12 + t2 * e2,
        t1 * s13 + t2 * s23 + t3 * e3,
        s12 * s12 + s13 * s13 + s23 * s23 + e2 * e2 + e3 * e3,
        -s12 * e1,
        -s13 * e1,
        s13 * s13 + s23 * s23 + e1 * e1 + e3 * e3,
        -s12 * s13 - s23 * e2,
        s12 * s12 + e1 * e1 + e2 * e2,
    ]
    return jnp.exp(2.0 * a)[..., None] * jnp.stack(terms, axis=-1)


def to_log_cholesky(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
    """θ = g⁻¹(π), the unique θ of a physical body; NaN where the body is not physical, which `is_physical` says.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_log_cholesky, to_log_cholesky
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> theta = to_log_cholesky(pi)
    >>> bool(jnp.allclose(from_log_cholesky(theta), pi))
    True
    """
    u = jnp.swapaxes(spatial.cholesky(pseudo_inertia(pi)), -1, -2)
    return read_factor(u)


def log_cholesky_jacobian(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
    """∂π/∂θ of `from_log_cholesky` in closed form; equals `jax.jacfwd(from_log_cholesky)(theta)`.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_log_cholesky
    >>> from jax_inertia.maths.inertial_parameters import log_cholesky_jacobian, to_log_cholesky
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> import jax
    >>> theta = to_log_cholesky(pi)
    >>> bool(jnp.allclose(log_cholesky_jacobian(theta), jax.jacfwd(from_log_cholesky)(theta)))
    True
    """
    return _jacobian(_UTU, theta)


# --- the other factor: P = U Uᵀ ----------------------------------------------------------------------------------


def from_log_cholesky_uut(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
    """π with pseudo-inertia U Uᵀ: m = e^{2α}, centre of mass t (Rucker and Wensing 2022 as Pinocchio has it).

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_log_cholesky_uut
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> theta = jnp.array([0.5 * jnp.log(2.0), -2, -2, -1, 0.1, 0, 0, 0, 0, 0.1])
    >>> from_log_cholesky_uut(theta)[:4]  # 2 kg with their centre 0.1 m up
    Array([2. , 0. , 0. , 0.2], dtype=float64)
    """
    a, d1, d2, d3, s12, s13, s23, t1, t2, t3 = _ten("theta", theta)
    e1, e2, e3 = jnp.exp(d1), jnp.exp(d2), jnp.exp(d3)
    xx = e1 * e1 + s12 * s12 + s13 * s13 + t1 * t1
    yy = e2 * e2 + s23 * s23 + t2 * t2
    zz = e3 * e3 + t3 * t3
    terms = [
        jnp.ones_like(t1),
        t1,
        t2,
        t3,
        yy + zz,
        -s12 * e2 - s13 * s23 - t1 * t2,
        -s13 * e3 - t1 * t3,
        xx + zz,
        -s23 * e3 - t2 * t3,
        xx + yy,
    ]
    return jnp.exp(2.0 * a)[..., None] * jnp.stack(terms, axis=-1)


def to_log_cholesky_uut(pi: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
    """Inverse of `from_log_cholesky_uut`; NaN where the body is not physical.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, to_log_cholesky_uut
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> to_log_cholesky_uut(pi)[7:]  # t is the centre of mass
    Array([0. , 0. , 0.1], dtype=float64)
    """
    # P = U Uᵀ with U upper: the ordinary Cholesky factor of P with both axes reversed.
    reverse = pseudo_inertia(pi)[..., ::-1, ::-1]
    return read_factor(spatial.cholesky(reverse)[..., ::-1, ::-1])


def log_cholesky_uut_jacobian(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
    """∂π/∂θ of `from_log_cholesky_uut` in closed form.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import from_com, from_log_cholesky_uut
    >>> from jax_inertia.maths.inertial_parameters import log_cholesky_uut_jacobian, to_log_cholesky_uut
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> import jax
    >>> theta = to_log_cholesky_uut(pi)
    >>> bool(jnp.allclose(log_cholesky_uut_jacobian(theta), jax.jacfwd(from_log_cholesky_uut)(theta)))
    True
    """
    return _jacobian(_UUT, theta)


# --- both are quadratic in the ten entries of U ------------------------------------------------------------------

# Where the entries stand: the last diagonal one (e^α), then as d1, d2, d3, s12, s13, s23, t1, t2, t3 set them.
_PLACES = ((3, 3), (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))


def _quadratic(transposed_first: bool) -> np.ndarray:
    """T with π_p = ½ Σ_jk T_pjk u_j u_k for the pseudo-inertia UᵀU (or U Uᵀ), so that ∂π/∂u = T u."""
    t = np.zeros((10, 10, 10))
    for j, k in np.ndindex(10, 10):
        a, b = np.zeros((4, 4)), np.zeros((4, 4))
        a[_PLACES[j]], b[_PLACES[k]] = 1.0, 1.0
        p = a.T @ b if transposed_first else a @ b.T
        p = p + p.T
        moments = np.diagonal(p)[:3].sum() - np.diagonal(p)[:3]
        t[:, j, k] = [
            p[3, 3],
            *p[:3, 3],
            moments[0],
            -p[0, 1],
            -p[0, 2],
            moments[1],
            -p[1, 2],
            moments[2],
        ]
    return t


_UTU, _UUT = _quadratic(True), _quadratic(False)


def _entries(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10"]:
    """u, the entries of U that are not zero."""
    one = jnp.ones_like(theta[..., :1])
    unscaled = jnp.concatenate([one, jnp.exp(theta[..., 1:4]), theta[..., 4:]], axis=-1)
    return jnp.exp(theta[..., :1]) * unscaled


@in_full_precision
def _jacobian(t: np.ndarray, theta: Float[Array, "*b 10"]) -> Float[Array, "*b 10 10"]:
    """(T u) ∂u/∂θ; ∂u/∂θ is diagonal but for α, which scales all of u."""
    theta = last_axes("theta", theta, (10,), _ORDER["theta"])
    u = _entries(theta)
    slope = jnp.einsum("pjk,...k->...pj", t.astype(theta.dtype), u)
    scale = jnp.broadcast_to(u[..., :1], (*u.shape[:-1], 6))
    rest = slope[..., 1:] * jnp.concatenate([u[..., 1:4], scale], axis=-1)[..., None, :]
    return jnp.concatenate([jnp.sum(slope * u[..., None, :], -1, keepdims=True), rest], axis=-1)


@in_full_precision
def factor(theta: Float[Array, "*b 10"]) -> Float[Array, "*b 4 4"]:
    """U of either map as a matrix: e^α [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], …].

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import factor, from_com, pseudo_inertia, to_log_cholesky
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> u = factor(to_log_cholesky(pi))
    >>> bool(jnp.allclose(u.T @ u, pseudo_inertia(pi)))
    True
    """
    at = np.zeros((10, 4, 4))
    for k, place in enumerate(_PLACES):
        at[k][place] = 1.0
    return jnp.einsum("kij,...k->...ij", at.astype(theta.dtype), _entries(theta))


def read_factor(u: Float[Array, "*b 4 4"]) -> Float[Array, "*b 10"]:
    """θ of a matrix U with positive diagonal, the inverse of `factor`.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import factor, from_com, read_factor, to_log_cholesky
    >>> pi = from_com(jnp.array(2.0), jnp.array([0.0, 0.0, 0.1]), jnp.diag(jnp.array([0.02, 0.02, 0.01])))
    >>> bool(jnp.allclose(read_factor(factor(to_log_cholesky(pi))), to_log_cholesky(pi)))
    True
    """
    scale = u[..., 3, 3]
    n = u / scale[..., None, None]
    logs = [jnp.log(n[..., i, i]) for i in range(3)]
    rest = [n[..., i, j] for i, j in _PLACES[4:]]
    return jnp.stack([jnp.log(scale), *logs, *rest], axis=-1)


def as_bodies(pi: Float[Array, "b 10"], thinnest: float = 0.01) -> Float[Array, "b 10"]:
    """π with a mass, and a spread of at least `thinnest` [m] about its centre, in all directions.

    >>> import jax.numpy as jnp
    >>> from jax_inertia.maths.inertial_parameters import as_bodies, is_physical
    >>> point = jnp.array([[2.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.0, 0.02]])
    >>> bool(is_physical(point)[0]), bool(is_physical(as_bodies(point))[0])
    (False, True)
    """
    mass = jnp.maximum(pi[:, 0], 1e-2)
    com = pi[:, 1:4] / mass[:, None]
    spread = pseudo_inertia(pi)[:, :3, :3]
    about = spread - mass[:, None, None] * com[:, :, None] * com[:, None, :]
    values, axes = jnp.linalg.eigh(about)
    values = jnp.maximum(values, (thinnest**2 * mass)[:, None])
    about = jnp.sum(axes[:, :, None, :] * axes[:, None, :, :] * values[:, None, None, :], axis=-1)
    trace = jnp.trace(about, axis1=1, axis2=2)
    inertia = trace[:, None, None] * jnp.eye(3, dtype=pi.dtype) - about
    return from_com(mass, com, inertia)
