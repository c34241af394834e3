"""A diagnosis of the whole robot without a log: for what is said of one."""

import numpy as np

from jax_inertia.diagnosis.result import Diagnosis, Found, Remainder, Shrink, Trace, Verdict


def diagnosis(verdict: Verdict, *found: Found) -> Diagnosis:
    shrink = Shrink(1.0, 0.5, 0.1, 0.1, {"knee": (1.0, 0.1)})
    rows = np.zeros((2, 1))
    return Diagnosis(
        verdict=verdict,
        confidence=0.9,
        log_odds=20.0,
        headline="The model lacks friction.",
        found=found,
        joints={},
        presliding={},
        friction={},
        as_bought=-10.0,
        heldout=shrink,
        validation=None,
        test=None,
        remainder=Remainder(0.1, {"knee": 1.0}, (), 0.1),
        chi2=2.0,
        noise_floor=1.0,
        per_joint_rms={"knee": 1.0},
        share={"knee": 1.0},
        inertials={},
        notes=("of its own",),
        trace=Trace(np.zeros(2), rows, rows, rows, ("knee",), {"q": rows, "v": rows, "tau": rows}),
        units={"knee": "N m"},
    )
