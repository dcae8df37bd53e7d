using System;

namespace Armcell.Logic
{
    /// <summary>What holds an object: friction alone, a joint as soon as it is gripped, or a weak joint only
    /// when it slips.</summary>
    public enum GripMode { Friction, Weld, Hybrid }

    /// <summary>What the caller has to do after a step.</summary>
    public enum GripAction
    {
        None,
        /// <summary>Remember the object's pose in the hand: slip is measured from it.</summary>
        Remember,
        /// <summary>Fix the object to the hand.</summary>
        Weld,
        /// <summary>Take the joint away.</summary>
        Release
    }

    [Serializable]
    public class GripSettings
    {
        public GripMode mode = GripMode.Friction;
        public double maxWidth = 0.08; // [m]
        public double maxForce = 70.0; // [N] per finger
        public double widthPerJoint = 2.0; // width = widthPerJoint * q + widthOffset
        public double widthOffset;
        public double fingerSpeed = 0.05; // [m/s] of each finger
        public double slip = 0.002; // [m] before "hybrid" fixes the object
        public double turn = 0.05; // [rad]

        public double Width(double q)
        {
            return q * widthPerJoint + widthOffset;
        }

        public double Joint(double width)
        {
            return (width - widthOffset) / widthPerJoint;
        }

        /// <summary>Force or torque of a finger joint that presses with so many newtons per finger.</summary>
        public double JointForce(double force)
        {
            return force * Math.Abs(widthPerJoint) / 2.0;
        }
    }

    /// <summary>Opens and closes a gripper, and knows when it has arrived, stands, holds and slips.</summary>
    public class Grip
    {
        const double k_Arrived = 1e-3; // [m] from the width that was asked
        const double k_Stands = 2e-3; // [m/s] of the width, slower counts as standing
        const double k_StallTime = 0.15; // [s] that the fingers stand before they count as stalled
        const double k_Timeout = 4.0; // [s]
        const double k_Settling = 0.2; // [s] both fingers press before the object is fixed or watched

        readonly GripSettings m_Settings;
        readonly Action<string> m_Say;
        Action<string> m_Ended;
        bool m_Running, m_Closing, m_Welded, m_Watched, m_Release;
        double m_Began, m_Still, m_Last;
        string m_Item;
        double m_Since;

        /// <summary>Width [m] that was asked, and the one the fingers are led to now.</summary>
        public double Target { get; private set; }
        public double SetPoint { get; private set; }
        /// <summary>[N] per finger at most.</summary>
        public double Force { get; private set; }
        /// <summary>What both fingers press on while they close, or is fixed; null when nothing is held.</summary>
        public string Held { get; private set; }
        public bool IsWelded
        {
            get { return m_Welded; }
        }

        /// <param name="say">told of every weld, release and end of a command</param>
        public Grip(GripSettings settings, double width, Action<string> say)
        {
            m_Settings = settings;
            m_Say = say;
            Target = SetPoint = width;
            Force = settings.maxForce;
        }

        /// <summary>As /gripper_command means it: 0 or more is a width [m], below 0 closes with that force [N].</summary>
        public void Command(double value, double now, double width)
        {
            if (!Words.IsFinite(value))
            {
                m_Say("refused: gripper command " + Words.G(value));
                return;
            }
            Move(Math.Max(value, 0.0), value < 0 ? -value : 0.0, now, width, null);
        }

        /// <summary>Begin to open or close; a force of 0 is the largest.</summary>
        /// <param name="width">where the fingers are [m]</param>
        /// <param name="ended">told "done: ..." or "stopped: ..."; may be null</param>
        public void Move(double to, double force, double now, double width, Action<string> ended)
        {
            if (m_Running) End("stopped: cancelled");
            Target = Math.Min(Math.Max(to, 0.0), m_Settings.maxWidth);
            Force = force > 0 ? Math.Min(force, m_Settings.maxForce) : m_Settings.maxForce;
            SetPoint = width;
            m_Closing = Target < width;
            if (!m_Closing) Forget();
            m_Running = true;
            m_Began = m_Still = now;
            m_Last = width;
            m_Ended = ended;
        }

        /// <summary>Be led to a width [m] by a trajectory that moves other joints, too.</summary>
        public void Lead(double to, double width)
        {
            if (m_Running) End("stopped: cancelled");
            Target = SetPoint = Math.Min(Math.Max(to, 0.0), m_Settings.maxWidth);
            if (Target > width + k_Arrived) Forget();
            m_Closing = Target < width - k_Arrived;
        }

        /// <summary>One period of physics [s].</summary>
        /// <param name="width">between the fingers [m]</param>
        /// <param name="pressed">what both fingers touch; null: nothing</param>
        /// <param name="slip">[m] the watched object has moved in the hand</param>
        /// <param name="turn">[rad]</param>
        public GripAction Step(double now, double period, double width, string pressed, double slip, double turn)
        {
            double way = 2.0 * m_Settings.fingerSpeed * period;
            SetPoint += Math.Max(Math.Min(Target - SetPoint, way), -way);
            if (m_Release)
            {
                m_Release = false;
                return GripAction.Release;
            }
            GripAction action = m_Closing ? Watch(now, pressed, slip, turn) : GripAction.None;
            Held = m_Welded ? m_Item : m_Closing ? pressed : null;
            if (m_Running) Look(now, period, width);
            return action;
        }

        /// <summary>The joint that fixed the object has broken.</summary>
        public void Broken()
        {
            m_Say("weld broke: " + m_Item);
            m_Welded = m_Watched = false;
            m_Item = null;
        }

        GripAction Watch(double now, string pressed, double slip, double turn)
        {
            if (m_Settings.mode == GripMode.Friction || m_Welded) return GripAction.None;
            if (pressed != m_Item && !(pressed == null && m_Watched)) // what slips may lose contact: keep watching
            {
                m_Item = pressed;
                m_Since = now;
                m_Watched = false;
            }
            if (m_Item == null || now - m_Since < k_Settling) return GripAction.None;
            if (m_Settings.mode == GripMode.Weld) return Weld("both fingers press it");
            if (!m_Watched)
            {
                m_Watched = true;
                return GripAction.Remember;
            }
            if (slip <= m_Settings.slip && turn <= m_Settings.turn) return GripAction.None;
            return Weld("it slipped " + Words.F(slip * 1000, 2) + " mm and " + Words.F(turn * 180 / Math.PI, 2) + " deg");
        }

        GripAction Weld(string reason)
        {
            m_Welded = true;
            m_Say("weld: " + m_Item + " is fixed to the hand (" + m_Settings.mode.ToString().ToLowerInvariant() + "): "
                + reason);
            return GripAction.Weld;
        }

        void Forget()
        {
            if (m_Welded)
            {
                m_Release = true;
                m_Say("release: " + m_Item);
            }
            m_Welded = m_Watched = false;
            m_Item = null;
        }

        void Look(double now, double period, double width)
        {
            if (Math.Abs(width - m_Last) > k_Stands * Math.Max(now - m_Still, period))
            {
                m_Last = width;
                m_Still = now;
            }
            bool arrived = Math.Abs(width - Target) <= k_Arrived;
            bool stalled = now - m_Still >= k_StallTime && now - m_Began > 2 * k_StallTime;
            if (!(arrived && Held == null) && !stalled && now - m_Began <= k_Timeout) return;
            End("done: " + (Held != null ? "holds " + Held : "stands at " + Words.F(width * 1000, 1) + " mm"));
        }

        void End(string text)
        {
            m_Running = false;
            m_Say(text);
            Action<string> ended = m_Ended;
            m_Ended = null;
            if (ended != null) ended(text);
        }
    }
}
