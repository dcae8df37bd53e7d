using UnityEngine;

namespace Armcell
{
    /// <summary>Time step and solver settings with which fingers hold what they grip. Unity's own let it slip.</summary>
    [DefaultExecutionOrder(-300)]
    [AddComponentMenu("armcell/Physics Setup")]
    public class PhysicsSetup : MonoBehaviour
    {
        [Tooltip("s")] public float fixedTimestep = 0.005f;
        public int solverIterations = 40;
        public int solverVelocityIterations = 20;
        [Tooltip("m/s2, Unity's axes")] public Vector3 gravity = new Vector3(0f, -9.81f, 0f);
        [Tooltip("1: real time, 0.2: slow motion; stamps and /clock follow")] public float timeScale = 1f;

        void Awake()
        {
            Time.fixedDeltaTime = fixedTimestep;
            Time.timeScale = timeScale;
            Physics.defaultSolverIterations = solverIterations;
            Physics.defaultSolverVelocityIterations = solverVelocityIterations;
            Physics.gravity = gravity;
            foreach (ArticulationBody body in GetComponentsInChildren<ArticulationBody>())
            {
                body.solverIterations = solverIterations;
                body.solverVelocityIterations = solverVelocityIterations;
            }
            foreach (Rigidbody body in GetComponentsInChildren<Rigidbody>())
            {
                body.solverIterations = solverIterations;
                body.solverVelocityIterations = solverVelocityIterations;
                body.sleepThreshold = 0f; // what sleeps tells of no contacts
            }
        }
    }
}
