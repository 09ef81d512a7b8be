"""Shading pairs per second and core, beside the rate of multiply-adds that this machine is measured to have.

Further rows of `lumigate bench kernels`.  The peer of the shading kernel is the most that it could be if its arithmetic were all there is:
the measured peak over `OPERATIONS` a pair, the division counted as one.
"""

from __future__ import annotations

import time

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..core.jit import kernel
from ..core.methods.cluster_shading import shade
from ..core.view.points import ShadingPoints
from .kernel_bench import REPEATS, _row, _take_turns

POINTS, LIGHTS = 16384, 4096
CLUSTERS, FUZZINESS = 256, 6
# Of one pair, on units for floating point: d 3, r^2 4, both cosines 6 + 2, their product 1, r^4 1, division 1, clamp 1, visibility 1, sums 3.
OPERATIONS = 23
LANES = 16 if llvmlite.binding.get_host_cpu_features().get("avx512f") else 8
CHAINS = 10  # independent ones, which hide the latency of 4 or 5 cycles on two ports
STEPS = 4_000_000


@intrinsic
def _multiply_add(context, count):
    """The sum of CHAINS vectors after `count` steps of x = x a + b, each kept in a register."""

    def generate(context, builder, signature, arguments):
        vector = ir.VectorType(ir.FloatType(), LANES)
        name = f"llvm.fma.v{LANES}f32"
        fma = builder.module.globals.get(name) or ir.Function(builder.module, ir.FunctionType(vector, [vector] * 3), name)
        factor, term = (ir.Constant(vector, [value] * LANES) for value in (0.5, 1.0))
        before, loop, after = builder.block, builder.append_basic_block("loop"), builder.append_basic_block("after")
        builder.branch(loop)
        builder.position_at_end(loop)
        step = builder.phi(ir.IntType(64))
        chains = [builder.phi(vector) for _ in range(CHAINS)]
        results = [builder.call(fma, [chain, factor, term]) for chain in chains]
        following = builder.add(step, ir.Constant(ir.IntType(64), 1))
        step.add_incoming(ir.Constant(ir.IntType(64), 0), before)
        step.add_incoming(following, loop)
        for k, (chain, result) in enumerate(zip(chains, results, strict=True)):
            chain.add_incoming(ir.Constant(vector, [float(k)] * LANES), before)
            chain.add_incoming(result, loop)
        builder.cbranch(builder.icmp_signed("<", following, arguments[0]), loop, after)
        builder.position_at_end(after)
        total = results[0]
        for result in results[1:]:
            total = builder.fadd(total, result)
        return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

    return types.float32(types.int64), generate


@kernel
def multiply_adds(count):
    """`count` steps of CHAINS times LANES multiply-adds."""
    return _multiply_add(count)


def shading_rows(points: int = POINTS, lights: int = LIGHTS, steps: int = STEPS, repeats: int = REPEATS) -> list[dict]:
    """Rows of the machine's peak and of the shading kernel of clustered methods, every light facing every point."""
    rng = np.random.default_rng(1)
    seen = ShadingPoints.allocate(points)
    seen.position[:] = np.column_stack([rng.random((points, 2)), np.zeros(points)])
    seen.ns[:] = 0, 0, 1
    above = np.column_stack(
        [rng.random((lights, 2)), np.full(lights, 1.0), np.tile([0.0, 0.0, -1.0], (lights, 1)), rng.random((lights, 3))]
    )
    table = np.ascontiguousarray(above.T, np.float32)
    visible = np.full((CLUSTERS, lights), 255, np.uint8)
    clusters = rng.integers(0, CLUSTERS, (points, FUZZINESS)).astype(np.int32)
    weights = np.full((points, FUZZINESS), 1 / FUZZINESS, np.float32)
    out = np.zeros((points, 3), np.float32)
    order = np.arange(points, dtype=np.int32)
    seconds = _take_turns(
        time.thread_time,
        {
            "peak": lambda: multiply_adds(steps),
            "shading": lambda: shade(seen, order, 0, points, table, 0, visible, clusters, weights, np.float32(np.inf), out),
        },
        repeats,
    )
    peak = steps * CHAINS * LANES / seconds["peak"] / 1e9
    pairs = points * lights / seconds["shading"] / 1e9
    return [
        _row("multiply-adds, the peak of this machine", peak, "G/s/core"),
        _row(
            f"shading pairs, blended over {FUZZINESS} clusters, against the peak over {OPERATIONS} operations",
            pairs,
            "Gpairs/s/core",
            peak / OPERATIONS,
        ),
    ]
