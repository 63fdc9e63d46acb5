# The part of PyBullet that Rollcast uses (it ships no types): add a function when you need one.
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

_Vector3: TypeAlias = tuple[float, float, float]
_Quaternion: TypeAlias = tuple[float, float, float, float]
_Vector3Like: TypeAlias = Sequence[float] | NDArray[np.floating[Any]]

DIRECT: int
GEOM_SPHERE: int
GEOM_BOX: int
GEOM_PLANE: int
GEOM_MESH: int
GEOM_HEIGHTFIELD: int
GEOM_FORCE_CONCAVE_TRIMESH: int
WORLD_FRAME: int
LINK_FRAME: int
ER_TINY_RENDERER: int
ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX: int
ER_NO_SEGMENTATION_MASK: int

# The world
def connect(method: int, key: int = ..., options: str = ...) -> int: ...
def disconnect(physicsClientId: int = ...) -> None: ...
def isConnected(physicsClientId: int = ...) -> int: ...
def resetSimulation(flags: int = ..., physicsClientId: int = ...) -> None: ...
def stepSimulation(physicsClientId: int = ...) -> tuple[Any, ...]: ...
def performCollisionDetection(physicsClientId: int = ...) -> None: ...
def setGravity(gravX: float, gravY: float, gravZ: float, physicsClientId: int = ...) -> None: ...
def setTimeStep(timeStep: float, physicsClientId: int = ...) -> None: ...
def getPhysicsEngineParameters(physicsClientId: int = ...) -> dict[str, float]: ...
def setPhysicsEngineParameter(
    *,
    fixedTimeStep: float = ...,
    numSolverIterations: int = ...,
    numSubSteps: int = ...,
    useSplitImpulse: int = ...,
    splitImpulsePenetrationThreshold: float = ...,
    collisionFilterMode: int = ...,
    contactBreakingThreshold: float = ...,
    restitutionVelocityThreshold: float = ...,
    erp: float = ...,
    contactERP: float = ...,
    frictionERP: float = ...,
    globalCFM: float = ...,
    enableConeFriction: int = ...,
    deterministicOverlappingPairs: int = ...,
    allowedCcdPenetration: float = ...,
    contactSlop: float = ...,
    solverResidualThreshold: float = ...,
    enableSAT: int = ...,
    physicsClientId: int = ...,
) -> None: ...

# Bodies
def createCollisionShape(
    shapeType: int,
    radius: float = ...,
    halfExtents: _Vector3Like = ...,
    height: float = ...,
    fileName: str = ...,
    meshScale: _Vector3Like = ...,
    planeNormal: _Vector3Like = ...,
    flags: int = ...,
    collisionFramePosition: _Vector3Like = ...,
    collisionFrameOrientation: _Vector3Like = ...,
    vertices: Sequence[_Vector3Like] = ...,
    indices: Sequence[int] = ...,
    heightfieldTextureScaling: float = ...,
    heightfieldData: Sequence[float] = ...,
    numHeightfieldRows: int = ...,
    numHeightfieldColumns: int = ...,
    replaceHeightfieldIndex: int = ...,
    physicsClientId: int = ...,
) -> int: ...
def createVisualShape(
    shapeType: int,
    radius: float = ...,
    halfExtents: _Vector3Like = ...,
    length: float = ...,
    fileName: str = ...,
    meshScale: _Vector3Like = ...,
    planeNormal: _Vector3Like = ...,
    flags: int = ...,
    rgbaColor: Sequence[float] = ...,
    specularColor: _Vector3Like = ...,
    visualFramePosition: _Vector3Like = ...,
    visualFrameOrientation: _Vector3Like = ...,
    vertices: Sequence[_Vector3Like] = ...,
    indices: Sequence[int] = ...,
    uvs: Sequence[Sequence[float]] = ...,
    normals: Sequence[_Vector3Like] = ...,
    physicsClientId: int = ...,
) -> int: ...
def removeCollisionShape(collisionShapeId: int, physicsClientId: int = ...) -> None: ...
def createMultiBody(
    baseMass: float = ...,
    baseCollisionShapeIndex: int = ...,
    baseVisualShapeIndex: int = ...,
    basePosition: _Vector3Like = ...,
    baseOrientation: _Vector3Like = ...,
    baseInertialFramePosition: _Vector3Like = ...,
    baseInertialFrameOrientation: _Vector3Like = ...,
    *,
    useMaximalCoordinates: int = ...,
    flags: int = ...,
    physicsClientId: int = ...,
) -> int: ...
def removeBody(bodyUniqueId: int, physicsClientId: int = ...) -> None: ...
def getNumBodies(physicsClientId: int = ...) -> int: ...
def changeDynamics(
    bodyUniqueId: int,
    linkIndex: int,
    mass: float = ...,
    lateralFriction: float = ...,
    spinningFriction: float = ...,
    rollingFriction: float = ...,
    restitution: float = ...,
    linearDamping: float = ...,
    angularDamping: float = ...,
    contactStiffness: float = ...,
    contactDamping: float = ...,
    frictionAnchor: int = ...,
    localInertiaDiagonal: _Vector3Like = ...,
    ccdSweptSphereRadius: float = ...,
    contactProcessingThreshold: float = ...,
    activationState: int = ...,
    jointDamping: float = ...,
    anisotropicFriction: _Vector3Like = ...,
    maxJointVelocity: float = ...,
    collisionMargin: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def getDynamicsInfo(
    bodyUniqueId: int, linkIndex: int, physicsClientId: int = ...
) -> tuple[Any, ...]: ...
def setCollisionFilterGroupMask(
    bodyUniqueId: int,
    linkIndexA: int,
    collisionFilterGroup: int,
    collisionFilterMask: int,
    physicsClientId: int = ...,
) -> None: ...
def setCollisionFilterPair(
    bodyUniqueIdA: int,
    bodyUniqueIdB: int,
    linkIndexA: int,
    linkIndexB: int,
    enableCollision: int,
    physicsClientId: int = ...,
) -> None: ...

# State
def resetBasePositionAndOrientation(
    bodyUniqueId: int,
    posObj: _Vector3Like,
    ornObj: _Vector3Like,
    physicsClientId: int = ...,
) -> None: ...
def getBasePositionAndOrientation(
    bodyUniqueId: int, physicsClientId: int = ...
) -> tuple[_Vector3, _Quaternion]: ...
def resetBaseVelocity(
    objectUniqueId: int,
    linearVelocity: _Vector3Like = ...,
    angularVelocity: _Vector3Like = ...,
    physicsClientId: int = ...,
) -> None: ...
def getBaseVelocity(bodyUniqueId: int, physicsClientId: int = ...) -> tuple[_Vector3, _Vector3]: ...
def applyExternalForce(
    objectUniqueId: int,
    linkIndex: int,
    forceObj: _Vector3Like,
    posObj: _Vector3Like,
    flags: int,
    physicsClientId: int = ...,
) -> None: ...
def applyExternalTorque(
    objectUniqueId: int,
    linkIndex: int,
    torqueObj: _Vector3Like,
    flags: int,
    physicsClientId: int = ...,
) -> None: ...
def getContactPoints(
    bodyA: int = ...,
    bodyB: int = ...,
    linkIndexA: int = ...,
    linkIndexB: int = ...,
    physicsClientId: int = ...,
) -> tuple[tuple[Any, ...], ...]: ...
def getClosestPoints(
    bodyA: int,
    bodyB: int,
    distance: float,
    linkIndexA: int = ...,
    linkIndexB: int = ...,
    physicsClientId: int = ...,
) -> tuple[tuple[Any, ...], ...]: ...

# Geometry and pictures
def getQuaternionFromEuler(
    eulerAngles: _Vector3Like, physicsClientId: int = ...
) -> _Quaternion: ...
def getEulerFromQuaternion(quaternion: _Vector3Like, physicsClientId: int = ...) -> _Vector3: ...
def getMatrixFromQuaternion(
    quaternion: _Vector3Like, physicsClientId: int = ...
) -> tuple[float, ...]: ...
def computeViewMatrix(
    cameraEyePosition: _Vector3Like,
    cameraTargetPosition: _Vector3Like,
    cameraUpVector: _Vector3Like,
    physicsClientId: int = ...,
) -> tuple[float, ...]: ...
def computeProjectionMatrixFOV(
    fov: float, aspect: float, nearVal: float, farVal: float, physicsClientId: int = ...
) -> tuple[float, ...]: ...
def getCameraImage(
    width: int,
    height: int,
    viewMatrix: Sequence[float] = ...,
    projectionMatrix: Sequence[float] = ...,
    lightDirection: _Vector3Like = ...,
    lightColor: _Vector3Like = ...,
    lightDistance: float = ...,
    shadow: int = ...,
    lightAmbientCoeff: float = ...,
    lightDiffuseCoeff: float = ...,
    lightSpecularCoeff: float = ...,
    renderer: int = ...,
    flags: int = ...,
    physicsClientId: int = ...,
) -> tuple[int, int, NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]: ...
def changeVisualShape(
    objectUniqueId: int,
    linkIndex: int,
    shapeIndex: int = ...,
    textureUniqueId: int = ...,
    rgbaColor: Sequence[float] = ...,
    specularColor: _Vector3Like = ...,
    flags: int = ...,
    physicsClientId: int = ...,
) -> None: ...
def loadTexture(textureFilename: str, physicsClientId: int = ...) -> int: ...
