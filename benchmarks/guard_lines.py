"""How `guard.py` keeps numbers: lines, their digests and tolerances; the main scene.

What a line may differ by where the bits do is its tolerance, relative to itself or to
the largest of its numbers. The modules `guard_motions` and `guard_questions` hold what
is computed: every function returns a dict of lines by name. Those whose programs are
counted take `watch` (a `census.Watch`), which is called around their sweeps.
"""

import hashlib

import numpy as np

import ziegler_jax as zj

ROUNDING = 1e-12
SAMPLE = 16  # numbers of an array that are kept beside its digest
QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
UNIT = zj.ConstantLoad(1.0)


def scene_of_the_main_job():
    """What the main job maps: its point and the numbers of its scene."""
    from ziegler_jax import __main__ as job

    return job.point, {"pin_radius": job.PIN_RADIUS}, job.KICK, job.SETTLE


# ---- lines


def number(x, tolerance=ROUNDING):
    return {"hex": float(x).hex(), "tolerance": tolerance}


def whole(n):
    return {"whole": int(n)}


def array(x, tolerance=ROUNDING, judged=None, sample=SAMPLE):
    """A digest of all numbers; of those that are judged quantiles, mean, and some.

    The mean lets no number change unseen by more than their count times the tolerance.
    """
    x = np.array(x, dtype=np.float64)
    x[np.isnan(x)] = np.nan  # one NaN for all
    content = x.astype("<f8").tobytes() + repr(x.shape).encode()
    kept = (x if judged is None else np.where(judged, x, np.nan)).ravel()
    at = np.unique(np.linspace(0, kept.size - 1, min(sample, kept.size)).astype(int))
    finite = kept[np.isfinite(kept)]
    quantiles = list(np.quantile(finite, QUANTILES)) if finite.size else []
    if quantiles and kept.size > sample:
        quantiles.append(finite.mean())
    return {
        "digest": hashlib.sha256(content).hexdigest()[:16],
        "shape": list(x.shape),
        "sample": [float(v).hex() for v in kept[at]],
        "quantiles": [float(v).hex() for v in quantiles],
        "tolerance": tolerance,
    }


def counts(name, found):
    """How many lanes ended in each way, and a digest of which."""
    found = np.asarray(found)
    lines = {f"{name}: {c.name}": whole((found == c).sum()) for c in zj.CODE}
    return {k: v for k, v in lines.items() if v["whole"]} | {
        f"{name}, all": array(found, 0.0)
    }


def dry(tau_s, tau_k=None):
    return zj.SetValuedCoulomb(tau_s, tau_k, pin_radius=1.0, load=UNIT)
