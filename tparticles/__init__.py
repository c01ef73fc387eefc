"""tparticles: particle systems on Taichi, rendered without a screen."""

import os as _os

# Taichi reads these when it is imported: no version post over the network, no banner on stdout.
_os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# Without a home, as services run, it would end the process.
if not (_os.environ.get("HOME") or _os.environ.get("XDG_CACHE_HOME")):
    _os.environ["HOME"] = _os.path.expanduser("~") if _os.path.isdir(_os.path.expanduser("~")) else "/tmp"
# Pydantic would search all installed packages for plugins.
_os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

__version__ = "0.1.0"

# Names that scenes use, by module. They load on first use: `import tparticles` alone does not import Taichi.
_PUBLIC = {
    "errors": ("BackendError", "InputError", "RunError", "TparticlesError"),
    "physics.colliders": ("Ball", "Capsule", "Plane", "Room"),
    "physics.cooling": ("Char", "Exponential", "Radiative"),
    "physics.emitters": ("Burst", "Emitter", "PerFrame", "Rate"),
    "physics.flows": ("ABC", "Plume", "Uniform", "Vortex"),
    "physics.forces": ("Drag", "Gravity"),
    "physics.grid_colliders": ("DistanceGrid", "Heightfield"),
    "physics.law": ("Bound", "Flow", "Sum"),
    "mesh_group": ("MeshGroup",),
    "physics.mesh": ("Mesh",),
    "physics.mesh_builders": ("cloth", "lattice", "rope", "sphere_shell", "spring_box"),
    "physics.mesh_files": ("read_mesh",),
    "physics.noise": ("CurlNoise",),
    "physics.repulsion": ("Repulsion",),
    "physics.shapes": ("Box", "Cone", "Disc", "Line", "Point", "Sphere"),
    "physics.spread": ("Spread",),
    "render.appearance": ("Glow", "Gradient", "Picture", "Ramp"),
    "render.camera": ("Camera",),
    "render.look": ("Look",),
    "render.wires": ("Wires",),
    "scene": ("Group", "Scene"),
    "schemes": ("Scheme", "adams", "bdf", "modified_euler", "runge_kutta", "splitting"),
    "simulation": ("Frame", "Simulation"),
    "spec": ("spec",),
    "stepping.control": ("ErrorControl", "Fixed", "PixelTolerance", "StabilityLimit"),
    "systems.motion": ("Advected", "Newtonian", "Still"),
    "track": ("Track",),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = sorted([*_HOME, "__version__"])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'tparticles' has no attribute '{name}'")
    from importlib import import_module

    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
