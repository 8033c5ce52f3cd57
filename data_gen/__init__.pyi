from .benchmark import drop_object as drop_object, generate_benchmark as generate_benchmark
from .benchmark_scenes import (
    BenchmarkMotion as BenchmarkMotion,
    BenchmarkOptions as BenchmarkOptions,
    changed as changed,
    changes_of as changes_of,
    placed as placed,
    rolled as rolled,
    scene_of as scene_of,
)
from .blind.bank import (
    COMMITMENT as COMMITMENT,
    DICTIONARY as DICTIONARY,
    BankOptions as BankOptions,
    digest as digest,
    generate_bank as generate_bank,
)
from .blind.controls import (
    ControlScore as ControlScore,
    same_class as same_class,
    score_controls as score_controls,
)
from .blind.explicit_cases import OUTSIDE as OUTSIDE
from .blind.plan import Shares as Shares
from .captures import (
    RingOptions as RingOptions,
    capture_folder as capture_folder,
    generate_captures as generate_captures,
)
from .config import (
    CameraConfig as CameraConfig,
    GeneratorConfig as GeneratorConfig,
    SolverConfig as SolverConfig,
    load_config as load_config,
)
from .dataset import ClipRecord as ClipRecord, Dataset as Dataset
from .degrade import draw_degradation as draw_degradation
from .engines import WorkerOptions as WorkerOptions, run_jobs as run_jobs
from .explicit.bodies import (
    FPS as FPS,
    FallingBody as FallingBody,
    Layout as Layout,
    falling_body as falling_body,
    lay_out as lay_out,
)
from .explicit.generate import draw_falls as draw_falls, generate_falls as generate_falls, read_falls as read_falls
from .explicit.kernels import (
    LOOK as LOOK,
    VIEW as VIEW,
    DrawnClips as DrawnClips,
    render_falls as render_falls,
    roll_out as roll_out,
)
from .generate import (
    GenerationSummary as GenerationSummary,
    generate_dataset as generate_dataset,
    prepare_surface as prepare_surface,
    render_view as render_view,
)
from .landing import refine_at_landing as refine_at_landing
from .objects.library import FAMILIES as FAMILIES, ObjectMesh as ObjectMesh, random_object as random_object
from .objects.user_meshes import load_user_mesh as load_user_mesh, objects_from_folder as objects_from_folder
from .render import Renderer as Renderer
from .scene import Drop as Drop, draw_drop as draw_drop, draw_look as draw_look, random_stream as random_stream
from .simulate import make_mesh as make_mesh, simulate_drop as simulate_drop
from .still_captures import (
    FLAT as FLAT,
    StillViews as StillViews,
    rendered_frames as rendered_frames,
    still_cameras as still_cameras,
    write_still_capture as write_still_capture,
)
from .surface import Backdrop as Backdrop, DrawnSurface as DrawnSurface, Lighting as Lighting
from .textures import floor_texture as floor_texture, vertex_colors as vertex_colors
