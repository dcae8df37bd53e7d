using System;
using UnityEngine;

namespace Armcell
{
    /// <summary>Links that are near each other by design do not collide (SRDF's disabled collisions).</summary>
    [AddComponentMenu("")]
    public class MayTouch : MonoBehaviour
    {
        [Serializable]
        public struct Pair
        {
            public GameObject a, b;
        }

        public Pair[] pairs = new Pair[0];

        void Start()
        {
            foreach (Pair pair in pairs)
                foreach (Collider a in Own(pair.a))
                    foreach (Collider b in Own(pair.b))
                        Physics.IgnoreCollision(a, b);
        }

        /// <summary>Colliders of a link, not of the links below it.</summary>
        static Collider[] Own(GameObject link)
        {
            ArticulationBody body = link.GetComponent<ArticulationBody>();
            return Array.FindAll(
                link.GetComponentsInChildren<Collider>(), c => c.GetComponentInParent<ArticulationBody>() == body);
        }
    }
}
