"""What is in the water: triangle meshes, their poses and the paper's objects (Fig. 3, 4, 6)."""

from sonarjax.scene import objects
from sonarjax.scene.mesh import Mesh, stack_meshes
from sonarjax.scene.pose import Pose

__all__ = ["Mesh", "Pose", "objects", "stack_meshes"]
