"""What is in the water: triangle meshes, their poses and the paper's objects (Fig. 3, 4, 6)."""

from sonarjax.scene import objects
from sonarjax.scene.mesh import Mesh, stack_meshes
from sonarjax.scene.pose import Pose
from sonarjax.scene.reduce import Reduction, SurfaceDistance, reduce_mesh, surface_distance

__all__ = ["Mesh", "Pose", "Reduction", "SurfaceDistance", "objects", "reduce_mesh", "stack_meshes", "surface_distance"]
