"""Sample points and the maps that bend them: sequences, hashes, discrete tables, warps of the unit square.

`hashing` counter-based random numbers; `sequences` Owen-scrambled Sobol, Halton and R2 points; `discrete`
alias tables and CDFs; `maps` disk, sphere, cone and hemisphere.
"""
