"""The suites of `lumigate bench`, each a list of steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from .auto_bench import auto_steps
from .bench_steps import Step
from .clustering_bench import clustering_rows
from .curves_bench import SCENES, SHARED, curves_steps
from .farm_bench import farm_rows
from .frames_bench import frames_rows
from .fuzzy_bench import fuzzy_rows
from .grid_bench import grid_steps
from .kernel_bench import ray_rows
from .lightmap_bench import lightmap_rows
from .peers.suite import peers_steps
from .preview_bench import preview_rows
from .radiosity_bench import radiosity_steps
from .scaling_bench import scaling_steps
from .shading_bench import shading_rows
from .skipping.single import single_rows
from .skipping.suite import skipping_rows
from .stress.suite import stress_steps
from .topology_bench import topology_rows
from .vals_bench import vals_rows

QUICK_SCENES = ("cornell", "corridor")
QUICK_SIZE = (320, 180)
QUICK_SAMPLES = 64  # of each half of the references


def papers_steps(folder: Path) -> list[Step]:
    """What each paper's tables are measured beside."""
    return [
        Step("instant radiosity: shadow rays", ray_rows),
        Step("fuzzy clustering (2022)", fuzzy_rows),
        Step("virtual area lights (2009)", vals_rows),
        Step("visibility gates (2014)", partial(topology_rows, folder)),
    ]


def quick_steps(folder: Path) -> list[Step]:
    """About ten minutes on two cores: two scenes, few settings."""
    curves = curves_steps(
        folder, QUICK_SCENES, QUICK_SIZE, spp=(4,), reference_samples=QUICK_SAMPLES, repeats=2, qualities=(0.25, 1.0), budgets=(2.0,)
    )
    auto = auto_steps(QUICK_SCENES, QUICK_SIZE, targets=(0.05, 0.01), budgets=(1.0, 3.0), reference_samples=QUICK_SAMPLES)
    scaling = scaling_steps((1_000, 100_000), (1024, 8192), ((160, 90), (320, 180)), (1, 200), repeats=2)
    return [Step("shadow rays", ray_rows), *curves, *auto, *scaling]


def full_steps(folder: Path) -> list[Step]:
    """Everything there is, for hours."""
    auto = [*auto_steps((*SCENES, *SHARED)), *grid_steps()]
    return [*curves_steps(folder), *peers_steps(folder), *auto, *scaling_steps(), *papers_steps(folder)]


def _alone(name: str, rows: Callable[..., list[dict]], pictured: bool = False) -> Callable[..., list[Step]]:
    """A suite of one step; pictured: it leaves pictures in the benchmark's folder."""

    def steps(folder: Path, **options) -> list[Step]:
        return [Step(name, partial(rows, *([folder] if pictured else []), **options))]

    return steps


# Keys as in `arguments.SUITES`; each makes the steps of a suite whose pictures go into a folder.
STEPS: dict[str, Callable[..., list[Step]]] = {
    "kernels": lambda folder: [Step("shadow rays", ray_rows), Step("shading", shading_rows)],
    "clustering": _alone("clustering", clustering_rows),
    "fuzzy": _alone("fuzzy", fuzzy_rows),
    "vals": _alone("vals", vals_rows),
    "topology": _alone("topology", topology_rows, pictured=True),
    "previews": _alone("previews", preview_rows),
    "radiosity": radiosity_steps,
    "curves": curves_steps,
    "peers": peers_steps,
    "lightmaps": _alone("lightmaps", lightmap_rows),
    "frames": _alone("frames", frames_rows, pictured=True),
    "farm": _alone("farm", farm_rows, pictured=True),
    "auto": lambda folder: auto_steps((*SCENES, *SHARED)),
    "grid": lambda folder, **options: grid_steps(**options),
    "scaling": lambda folder: scaling_steps(),
    "stress": stress_steps,
    "skipping": lambda folder: [Step("places", skipping_rows), Step("one by one", single_rows)],
    "papers": papers_steps,
    "quick": quick_steps,
    "full": full_steps,
}
