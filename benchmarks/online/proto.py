import sys, time, os
import sys
DT=sys.argv[4] if len(sys.argv)>4 else 'float64'
import jax; jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp, numpy as np, equinox as eqx, scipy.stats as st
from benchmarks.online.draws import *
from jax_inertia import load_model, mass_matrix
from jax_inertia.estimation.inertial_filter import make_estimator
from jax_inertia.estimation.priors import Load, Tolerance, Uncertainty
from jax_inertia.maths import inertial_parameters as ip
from jax_inertia.signals.residual import torque_residuals
from jax_inertia.model.load import body_pi
name, N, variant = sys.argv[1], int(sys.argv[2]), sys.argv[3]
SEC=2.0
who=subject(name); link=who.links[0]
robot=load_model(who.model)
obs=[];true=[]
t0=time.time()
for k in range(N):
    rng=np.random.default_rng([77,k])
    load=ball(who,link,rng)
    m=carrying(who.model,{link:load})
    path=trajectory(who,SEC,rng)
    obs.append(observed(who,path,forces(m,path),rng))
    true.append(body_pi(who.model,who.model.body(link).id)+load.pi())
true=np.array(true)
logs=jax.tree.map(lambda *x: np.stack(x),*obs)
tg=time.time()-t0
nv=who.model.nv
sa=noise_of_acceleration(who); stau=noise_of_torque(who)
M=np.asarray(mass_matrix(robot,jnp.asarray(logs.motion.q[0,0])))
both=np.sqrt(stau**2+np.diag(M@M.T)*sa**2)
class Capped(Uncertainty):
    load: Load
    cap: float
    def covariance(self,chart,nominal):
        own=self.load.covariance(chart,nominal)
        b=ip.from_com(jnp.full(nominal.shape[:-1],self.load.mass),ip.centre_of_mass(nominal),jnp.broadcast_to(0.1*self.load.mass*self.load.reach**2*jnp.eye(3),(*nominal.shape[:-1],3,3)))
        cap=Tolerance(mass=1e3,com=1e3,spread=self.cap).covariance(chart,nominal+b)
        return jnp.linalg.inv(jnp.linalg.inv(own)+jnp.linalg.inv(cap))
def report(tag,pi,cov,nis=None,extra=''):
    e=pi-true
    z=e[:,0]/np.sqrt(cov[:,0,0])
    n4=np.einsum('bi,bij,bj->b',e[:,:4],np.linalg.inv(cov[:,:4,:4]),e[:,:4])
    d=np.sqrt(np.einsum('bii->bi',cov)); cn=cov/d[:,:,None]/d[:,None,:]
    n10=np.einsum('bi,bij,bj->b',e/d,np.linalg.pinv(cn,hermitian=True,rcond=1e-12),e/d)
    lo,hi=st.chi2.interval(.95,4*N)
    print(f"{name:9s} {tag:26s} 1s {np.mean(abs(z)<1):.2f} 2s {np.mean(abs(z)<2):.3f} zrms {np.sqrt(np.mean(z**2)):.2f} med|e| {np.median(abs(e[:,0])):.4f} sig {np.median(np.sqrt(cov[:,0,0])):.4f} mean {e[:,0].mean():+.4f}; N4 {n4.mean():.2f} med {np.median(n4):.2f} p95 {np.mean(n4<st.chi2.ppf(.95,4)):.3f} [{lo/N:.2f},{hi/N:.2f}] N10 {n10.mean():.1f}/{np.median(n10):.1f}", '' if nis is None else f"NIS {nis:.3f}",extra,f"t {time.time()-t0:.0f}",flush=True)
def ekf(tag,**kw):
    est=make_estimator(robot,[link],**kw)
    @eqx.filter_jit
    def run(logs):
        def one(log):
            s,tr=est.run(est.initial(),log)
            x=s.belief.mean.reshape(-1,10)
            g=jax.scipy.linalg.block_diag(*est.chart.jacobian(x))
            return est.chart.to_pi(x)[0], g@s.belief.covariance@g.T, tr.innovation.nis, tr.innovation.rows, tr.innovation.accepted
        return jax.lax.map(one,logs,batch_size=16)
    pi,cov,nis,rows,acc=(np.asarray(v) for v in run(logs))
    report(tag,pi,cov,(nis[:,30:].sum()/rows[:,30:].sum()),f'rej {1-acc.mean():.3f}')
L0=Load(who.load,REACH)
if variant=='default': ekf('EKF default',prior=L0,sigma_tau=both)
if variant=='sa': ekf('EKF sigma_a',prior=L0,sigma_tau=stau,sigma_a=sa)
if variant=='cap1': ekf('EKF cap1',prior=Capped(L0,1.0),sigma_tau=both)
if variant=='cap1sa': ekf('EKF cap1 sa',prior=Capped(L0,1.0),sigma_tau=stau,sigma_a=sa)
if variant=='cap05sa': ekf('EKF cap.5 sa',prior=Capped(L0,0.5),sigma_tau=stau,sigma_a=sa)
if variant=='cap1sang': ekf('EKF cap1 sa nogate',prior=Capped(L0,1.0),sigma_tau=stau,sigma_a=sa,gate=1.0,drift=3600.)
def rowsof(log): return torque_residuals(robot,log,est.bodies,jnp.zeros(nv))
def acc(mode,cap):
    chart=est.chart; x0=est.prior.mean; nom=robot.pi[np.array(est.bodies)]
    P0=(Capped(L0,cap) if cap else L0).covariance(chart,nom)[0]
    iP=jnp.linalg.inv(P0)
    iS=jnp.diag(1/L0.sigma_pi()**2)
    def mapfit(L,eta,s0):
        def cost(x):
            pi=chart.to_pi(x); return pi@L@pi-2*eta@pi+s0+(x-x0)@iP@(x-x0)
        def run(x):
            def body(_,c):
                x,lam=c
                g=chart.jacobian(x); pi=chart.to_pi(x)
                H=g.T@L@g+iP; grad=g.T@(L@pi-eta)+iP@(x-x0)
                dx=-jnp.linalg.solve(H+lam*jnp.diag(jnp.diag(H)),grad)
                ok=cost(x+dx)<=cost(x)
                return jnp.where(ok,x+dx,x), jnp.where(ok,lam*0.2,lam*5+1e-9)
            return jax.lax.fori_loop(0,60,body,(x,jnp.asarray(1e-3)))[0]
        lin=jnp.linalg.solve(L+iS,eta+iS@nom[0])
        p=ip.pseudo_inertia(lin)
        # project: about its centre of mass, spread at least 1 cm
        m=jnp.maximum(lin[0],0.01); c=lin[1:4]/m
        sig=p[:3,:3]-m*jnp.outer(c,c)
        w,v=jnp.linalg.eigh(sig); w=jnp.maximum(w,m*1e-4)
        sig=(v*w)@v.T+m*jnp.outer(c,c)
        p=jnp.block([[sig,(m*c)[:,None]],[(m*c)[None],m[None,None]]])
        xs=jnp.stack([run(x0),run(chart.from_pi(ip.from_pseudo_inertia(p)))])
        cs=jax.vmap(cost)(xs); cs=jnp.where(jnp.isfinite(cs),cs,jnp.inf)
        x=xs[jnp.argmin(cs)]
        g=chart.jacobian(x)
        return chart.to_pi(x),g@jnp.linalg.inv(g.T@L@g+iP)@g.T,cs.min(),(cs[0]>cs[1]+1.0)
    def one(log,pit):
        Y,d=rowsof(log); Y=Y[:,:,0]
        rb=robot.with_pi(est.bodies,pit[None])
        Ms=jax.vmap(lambda q: mass_matrix(rb,q))(log.motion.q)
        R0=jnp.diag(jnp.asarray(stau)**2)
        def step(c,x):
            L,eta,s0,z,H,K=c
            Yk,dk,Mk=x
            if mode=='white':
                S=R0+Mk@Mk.T*sa**2; zz,HH=dk,Yk; Kn=K
            else:
                D=Mk/(WINDOW/RATE); sv=who.sigma_v**2
                zz=dk+D@z; HH=Yk+D@H
                S=R0+D@D.T*sv+D@K@D.T
                G=sv*D.T@jnp.linalg.inv(S)
                z,H,Kn=G@zz,G@HH,sv*jnp.eye(nv)-G@D*sv
            Si=jnp.linalg.inv(S)
            return (L+HH.T@Si@HH,eta+HH.T@Si@zz,s0+zz@Si@zz,z,H,Kn),None
        c0=(jnp.zeros((10,10)),jnp.zeros(10),jnp.zeros(()),jnp.zeros(nv),jnp.zeros((nv,10)),who.sigma_v**2*jnp.eye(nv))
        (L,eta,s0,*_),_=jax.lax.scan(step,c0,(Y,d,Ms))
        return mapfit(L,eta,s0)
    pi,cov,c,sw=(np.asarray(v) for v in jax.jit(lambda *l: jax.lax.map(lambda a: one(*a),l,batch_size=16))(logs,true))
    report(f'accum {mode} cap {cap}',pi,cov,np.mean(c)/(logs.a.shape[1]*nv),f'other start better {sw.mean():.3f}')
est=make_estimator(robot,[link],prior=L0,sigma_tau=1.0)
if variant=='accw0': acc('white',0)
if variant=='accw1': acc('white',1.0)
if variant=='accm1': acc('ma1',1.0)
if variant=='accm05': acc('ma1',0.5)

from jax_inertia.estimation.exact_memory import make_exact_estimator
if variant=='exact':
    rb=robot.astype(DT)
    ex=make_exact_estimator(rb,[link],sigma_tau=stau,sigma_v=who.sigma_v,prior=L0)
    @eqx.filter_jit
    def run(logs):
        def one(log):
            def f(s,x): 
                s,o=ex.step(s,x,WINDOW/RATE); return s,(o.nis,o.rows,o.weight)
            s,o=jax.lax.scan(f,ex.initial(),log)
            g=jax.scipy.linalg.block_diag(*ex.chart.jacobian(s.belief.mean.reshape(-1,10)))
            return ex._pi(s.belief.mean),(g@s.belief.covariance@g.T),*o
        return jax.lax.map(one,logs,batch_size=16)
    pi,cov,nis,rows,w=(np.asarray(v,float) for v in run(logs))
    report('exact '+DT,pi,cov,nis[:,30:].sum()/rows[:,30:].sum(),f'weight<.5 {np.mean(w<.5):.3f}')
    e=pi-true; n4=np.einsum('bi,bij,bj->b',e[:,:4],np.linalg.inv(cov[:,:4,:4]),e[:,:4])
    np.set_printoptions(precision=3,suppress=True,linewidth=200)
    for b in np.argsort(-n4)[:4]: print(b,n4[b],'true',true[b],'est',pi[b],'sd',np.sqrt(np.diag(cov[b])))
