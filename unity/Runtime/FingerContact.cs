using System.Collections.Generic;
using UnityEngine;

namespace Armcell
{
    /// <summary>What a finger touches. The gripper's controller puts it on each finger.</summary>
    [AddComponentMenu("")]
    public class FingerContact : MonoBehaviour
    {
        const int k_Steps = 3; // of physics after which a contact that is not told again is over

        readonly Dictionary<Rigidbody, double> m_Touched = new Dictionary<Rigidbody, double>();

        void OnCollisionEnter(Collision collision)
        {
            Touch(collision);
        }

        void OnCollisionStay(Collision collision)
        {
            Touch(collision);
        }

        public bool Touches(Rigidbody body)
        {
            double at;
            return m_Touched.TryGetValue(body, out at)
                && Time.fixedTimeAsDouble - at <= k_Steps * Time.fixedDeltaTime + 1e-9;
        }

        public IEnumerable<Rigidbody> Touched
        {
            get
            {
                foreach (Rigidbody body in m_Touched.Keys)
                    if (body != null && Touches(body)) yield return body;
            }
        }

        void Touch(Collision collision)
        {
            if (collision.rigidbody != null) m_Touched[collision.rigidbody] = Time.fixedTimeAsDouble;
        }
    }
}
