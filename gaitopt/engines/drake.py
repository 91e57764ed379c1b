"""Adapter of Drake (drake.mit.edu): joint coordinates, compliant point contacts, several contact solvers."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, PlanarJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator as DrakeSimulator
from pydrake.systems.framework import DiagramBuilder

from gaitopt.arrays import Array
from gaitopt.engines.plant import POINT_RADIUS, Tree

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {"solver": "lagged", "stiffness": None, "dissipation": None, "near_rigid": 1.0, "stiction": 1e-4},
    "best": {"solver": "sap", "stiffness": 1e12, "dissipation": 0.0, "near_rigid": 1.0, "stiction": 1e-4},
}
"""``best`` is the solver SAP with a contact stiffer than SAP's near-rigid limit, so that the time step sets the
stiffness. A contact that sticks creeps at up to ``stiction`` [m/s], except with SAP."""
NOT_TURNING = 1e9
"""Moment of inertia, relative to mass and square of a metre, of a body that slides without turning."""
PLANE = RotationMatrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Axes of the planar joint: Drake moves it in its x and y and turns it about its z, here x, z and -y of the world."""


class Simulator:
    """A walker in Drake; the parameters are those of ``gaitopt.engines.mujoco.Simulator``."""

    name: ClassVar[str] = "drake"
    version: ClassVar[str] = version("drake")
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = SETTINGS

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        self._tree, self._dt, radius = tree, dt, settings.get("radius", POINT_RADIUS)
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=dt, contact_model="point", discrete_contact_approximation=settings["solver"]
        )
        config.sap_near_rigid_threshold = settings["near_rigid"]
        config.stiction_tolerance = settings["stiction"]
        plant, self._scene = AddMultibodyPlant(config, builder)
        plant.mutable_gravity_field().set_gravity_vector([tree.gravity[0], 0, tree.gravity[1]])
        material = {"dissipation": settings["dissipation"], "point_stiffness": settings["stiffness"]}
        material = {name: value for name, value in material.items() if value is not None}

        def contact(coefficient: float) -> ProximityProperties:
            properties = ProximityProperties()
            AddContactMaterial(properties=properties, friction=CoulombFriction(coefficient, coefficient), **material)
            return properties

        # a pair of surfaces has 2 a b / (a + b); on ground with b this is s b for a = s b / (2 - s)
        coefficients = [friction * foot.share / (2 - foot.share) for foot in tree.feet]

        low = 0.0 if tree.feet[0].radius else -radius
        world = plant.world_body()
        ground = RigidTransform([0, 0, low])
        self._ground = plant.RegisterCollisionGeometry(world, ground, HalfSpace(), "ground", contact(friction))
        bodies: list[Any] = []
        for k, body in enumerate(tree.bodies):
            x, z = body.com
            turning = max(body.inertia, 1e-12 * body.mass) / body.mass + x * x + z * z
            turning = NOT_TURNING * (1.0 + turning) if tree.slides else turning
            unit_inertia = UnitInertia(turning, turning, turning)  # only the one about y matters in the plane
            inertia = SpatialInertia(body.mass, [x, 0, z], unit_inertia, skip_validity_check=True)
            bodies.append(plant.AddRigidBody(f"body{k}", inertia))
            if body.parent < 0 or tree.slides:
                below = world if body.parent < 0 else bodies[body.parent]
                frames = [
                    plant.AddFrame(FixedOffsetFrame(f"plane{k}{j}", frame, RigidTransform(PLANE)))
                    for j, frame in enumerate((below.body_frame(), bodies[k].body_frame()))
                ]
                plant.AddJoint(PlanarJoint(f"plane{k}", *frames, [0, 0, 0]))
            else:
                offset = RigidTransform([body.position[0], 0, body.position[1]])
                hinge = plant.AddFrame(FixedOffsetFrame(f"hinge{k}", bodies[body.parent].body_frame(), offset))
                plant.AddJoint(RevoluteJoint(f"joint{k}", hinge, bodies[k].body_frame(), [0, 1, 0], 0.0))
                if body.rotor:
                    motor = plant.AddJointActuator(f"motor{k}", plant.GetJointByName(f"joint{k}"))
                    motor.set_default_rotor_inertia(body.rotor)
                    motor.set_default_gear_ratio(1.0)
        self._feet = [
            plant.RegisterCollisionGeometry(
                bodies[foot.body], RigidTransform([foot.tip[0], 0, foot.tip[1]]), Sphere(foot.radius or radius),
                f"foot{k}", contact(coefficients[k]),
            )
            for k, foot in enumerate(tree.feet)
        ]  # fmt: skip
        plant.Finalize()
        self._plant, self._indices = plant, [body.index() for body in bodies]
        self._simulator = DrakeSimulator(builder.Build())
        context = self._simulator.get_mutable_context()
        self._state, self._shapes = (system.GetMyMutableContextFromRoot(context) for system in (plant, self._scene))
        planes = range(len(tree.bodies)) if tree.slides else (0,)
        self._planes = [plant.GetJointByName(f"plane{k}") for k in planes]
        self._joints = [plant.GetJointByName(f"joint{k}") for k in range(len(planes), len(tree.bodies))]
        self._steps, self._touching = 0, (True,) * len(tree.feet)
        self._force = plant.get_applied_generalized_force_input_port()
        if any(body.rotor for body in tree.bodies):
            plant.get_actuation_input_port().FixValue(self._state, np.zeros(plant.num_actuators()))

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""
        for k, plane in enumerate(self._planes):
            plane.set_translation(self._state, q[2 * k : 2 * k + 2])
            plane.set_translational_velocity(self._state, v[2 * k : 2 * k + 2])
        if not self._tree.slides:
            self._planes[0].set_rotation(self._state, -q[2])
            self._planes[0].set_angular_velocity(self._state, -v[2])
        for joint, angle, rate in zip(self._joints, q[3:], v[3:], strict=False):
            joint.set_angle(self._state, angle)
            joint.set_angular_rate(self._state, rate)

    def step(self, force: Array, touching: tuple[bool, ...]) -> tuple[Array, Array, Array]:
        """Advance by one time step under forces on the coordinates; see ``outcome.Simulator``."""
        if touching != self._touching:
            self._switch(touching)
        applied = np.zeros(self._plant.num_velocities())
        for k, plane in enumerate(self._planes):
            first = plane.velocity_start()
            applied[first : first + 2] = force[2 * k : 2 * k + 2]
        if not self._tree.slides:
            applied[self._planes[0].velocity_start() + 2] = -force[2]
        for joint, torque in zip(self._joints, force[3:], strict=False):
            applied[joint.velocity_start()] = torque
        self._force.FixValue(self._state, applied)
        self._steps += 1
        self._simulator.AdvanceTo(self._steps * self._dt)
        forces = np.zeros((len(self._feet), 2))
        results = self._plant.get_contact_results_output_port().Eval(self._state)
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            on_ground = info.point_pair().id_A in self._feet  # the force acts on B
            foot = self._feet.index(info.point_pair().id_A if on_ground else info.point_pair().id_B)
            forces[foot] += (-1 if on_ground else 1) * info.contact_force()[[0, 2]]
        q = [value for plane in self._planes for value in plane.get_translation(self._state)]
        v = [value for plane in self._planes for value in plane.get_translational_velocity(self._state)]
        q += [] if self._tree.slides else [-self._planes[0].get_rotation(self._state)]
        v += [] if self._tree.slides else [-self._planes[0].get_angular_velocity(self._state)]
        q += [joint.get_angle(self._state) for joint in self._joints]
        v += [joint.get_angular_rate(self._state) for joint in self._joints]
        return np.array(q), np.array(v), forces

    def _switch(self, touching: tuple[bool, ...]) -> None:
        """Allow contacts with the ground for the feet that may touch it, and exclude them for the others."""
        filters = self._scene.collision_filter_manager(self._shapes)
        for foot, on in zip(self._feet, touching, strict=True):
            pair, declaration = (GeometrySet(foot), GeometrySet(self._ground)), CollisionFilterDeclaration()
            filters.Apply(declaration.AllowBetween(*pair) if on else declaration.ExcludeBetween(*pair))
        self._touching = touching
