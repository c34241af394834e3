import sys
sys.argv.append("--gpu")
import jax; jax.config.update("jax_enable_x64", True)
from concurrent.futures import ThreadPoolExecutor
import jax.numpy as jnp, numpy as np
from benchmarks import jacobian as b
model=b.humanoid(); robot=b.load_model(model)
nominal=b.inertial_parameters.to_log_cholesky(robot.pi[np.array([robot.body_index(x) for x in b.BODIES])])
theta=np.asarray(nominal).ravel()+0.1*np.random.default_rng(1).normal(size=(256,20))
pool=ThreadPoolExecutor(6)
print(jax.devices())
print('g',b.agreement({d:b.of_g() for d in b.DTYPES},{d:(jnp.asarray(theta[:,:10],d),) for d in b.DTYPES},pool))
print('h',b.agreement({d:b.of_h(robot.astype(d)) for d in b.DTYPES},{d:(jnp.asarray(theta,d),*b.states(model,256,d)) for d in b.DTYPES},pool))
