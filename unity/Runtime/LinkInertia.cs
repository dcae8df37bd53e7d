using UnityEngine;

namespace Armcell
{
    /// <summary>A link's mass distribution as its URDF has it: Unity would make it anew from the colliders.</summary>
    [AddComponentMenu("")]
    public class LinkInertia : MonoBehaviour
    {
        public Vector3 centerOfMass;
        public Vector3 moments = Vector3.one;
        public Quaternion axes = Quaternion.identity;

        void Start()
        {
            ArticulationBody body = GetComponent<ArticulationBody>();
#if UNITY_2022_2_OR_NEWER
            body.automaticCenterOfMass = false;
            body.automaticInertiaTensor = false;
#endif
            body.centerOfMass = centerOfMass;
            body.inertiaTensor = moments;
            body.inertiaTensorRotation = axes;
        }
    }
}
