"""What others would use, each as its own users would write it.

A peer that takes part in the work-precision comparison has

    run(scene, q, start, span, rtol) -> states, seconds

`scene` one of `scenes.SCENES`; `q` loads, (n,); `start` four numbers; `span` the time;
`rtol` the relative and absolute tolerance of a step. `states` are phi1, phi2, w1, w2 at
`span`, (n, 4); `seconds`, by `measure.clock`, are those of the solve: what is compiled
is compiled before. Importing it raises ImportError (or OSError) where it cannot be
installed; `run` raises NotImplementedError for a scene or tolerance it has no code for.
`LANES`, where a peer has it, is how many of the loads are enough to time it.
"""
