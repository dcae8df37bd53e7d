using System;
using System.Collections.Generic;
using System.Linq;
using Armcell.Logic;
using NUnit.Framework;

namespace Armcell.Tests
{
    public class AxesTests
    {
        [Test]
        public void GoldenVector()
        {
            // Unity (0.1, 0.025, 0.5), Euler (0, 30, 0) deg is ROS (0.5, -0.1, 0.025), yaw -30 deg.
            Vec3 p = Axes.ToRos(new Vec3(0.1, 0.025, 0.5));
            Assert.AreEqual(new Vec3(0.5, -0.1, 0.025), p);
            double half = 15.0 * Math.PI / 180.0;
            Quat q = Axes.ToRos(new Quat(0, Math.Sin(half), 0, Math.Cos(half)));
            Assert.AreEqual(0.0, q.x, 0.0);
            Assert.AreEqual(0.0, q.y, 0.0);
            Assert.AreEqual(0.2588190, q.z, 1e-7);
            Assert.AreEqual(-0.9659258, q.w, 1e-7);
            Assert.AreEqual(0.0, Quat.Angle(q, Quat.FromRpy(0, 0, -Math.PI / 6)), 1e-7);
        }

        [Test]
        public void ThereAndBack()
        {
            Vec3 p = new Vec3(1, 2, 3);
            Quat q = Quat.FromRpy(0.3, -0.7, 2.0);
            Assert.AreEqual(p, Axes.ToUnity(Axes.ToRos(p)));
            Assert.AreEqual(p, Axes.SizeToUnity(Axes.SizeToRos(p)));
            Assert.AreEqual(0.0, Quat.Angle(q, Axes.ToUnity(Axes.ToRos(q))), 1e-7);
        }
    }

    public class JointTests
    {
        static JointTable Table()
        {
            return new JointTable(new[]
            {
                new JointSpec { name = "a", lower = -1, upper = 1 },
                new JointSpec { name = "turn", kind = JointKind.Continuous },
                new JointSpec { name = "f1", kind = JointKind.Prismatic, lower = 0, upper = 0.04, finger = true },
                new JointSpec { name = "f2", kind = JointKind.Prismatic, mimic = "f1", multiplier = -2, offset = 0.1 }
            });
        }

        [Test]
        public void DrivesWantDegreesAndMetres()
        {
            Assert.AreEqual(90.0, Table()["a"].ToDrive(Math.PI / 2), 1e-12);
            Assert.AreEqual(Math.PI, Table()["turn"].FromDrive(180.0), 1e-12);
            Assert.AreEqual(0.03, Table()["f1"].ToDrive(0.03), 0.0);
        }

        [Test]
        public void FollowersAreNotCommandedByName()
        {
            JointTable table = Table();
            Assert.AreEqual("a turn f1", string.Join(" ", table.Driven));
            JointSpec follower = table.Followers("f1").Single();
            Assert.AreEqual(0.04, table.Followed(follower, 0.03), 1e-12);
            Assert.AreEqual(-0.02, table.Followed(follower, 0.01, true), 1e-12);
            RefusedException error = Assert.Throws<RefusedException>(() => table.CheckNames(new[] { "f2" }));
            Assert.AreEqual("unknown joint 'f2'; known: a, f1, turn", error.Message);
        }

        [Test]
        public void LoopsOfFollowersAreRefused()
        {
            JointSpec one = new JointSpec { name = "one", mimic = "two" };
            JointSpec two = new JointSpec { name = "two", mimic = "one" };
            Assert.Throws<RefusedException>(() => new JointTable(new[] { one, two }));
        }

        [Test]
        public void TurnsAreCounted()
        {
            AngleTracker tracker = new AngleTracker();
            double last = 0.0;
            for (double angle = 0.0; angle < 20.0; angle += 0.1)
                last = tracker.Track(Math.IEEERemainder(angle, 2 * Math.PI));
            Assert.AreEqual(19.9, last, 1e-6);
            Assert.AreEqual(19.9 - Math.IEEERemainder(19.9, 2 * Math.PI), tracker.Turns, 1e-6);
        }

        [Test]
        public void ContinuousJointsTakeTheShortWay()
        {
            TrajectoryPoints points = new TrajectoryPoints
            {
                names = new[] { "turn" }, times = new[] { 1.0 }, positions = new[] { new[] { -3.0 } }
            };
            JointTrajectory found = points.Checked(Table(), n => 9.0, n => 0.0);
            Assert.AreEqual(-3.0 + 4 * Math.PI, found.positions[1][0], 1e-12);
            Assert.AreEqual(-3.0, points.positions[0][0], 0.0); // what came is left as it was
        }

        [Test]
        public void BadTrajectoriesAreRefused()
        {
            var cases = new Dictionary<string, TrajectoryPoints>
            {
                { "joint 'a' is named twice", Make(new[] { "a", "a" }, new[] { 1.0 }, new[] { 0.0, 0.0 }) },
                { "point 1 is at 1 s: time must begin at 0 or later, and increase",
                    Make(new[] { "a" }, new[] { 1.0, 1.0 }, new[] { 0.0 }, new[] { 0.0 }) },
                { "point 0 is at -0.5 s: time must begin at 0 or later, and increase",
                    Make(new[] { "a" }, new[] { -0.5 }, new[] { 0.0 }) },
                { "the points have no positions", Make(new[] { "a" }, new[] { 1.0 }, new double[0]) },
                { "point 1 has 2 positions for 1 joints",
                    Make(new[] { "a" }, new[] { 1.0, 2.0 }, new[] { 0.0 }, new[] { 0.0, 1.0 }) },
                { "point 0: positions has a value that is not finite",
                    Make(new[] { "a" }, new[] { 1.0 }, new[] { double.NaN }) },
                { "point 0: joint 'a' at 1.2 is outside its limits [-1, 1]",
                    Make(new[] { "a" }, new[] { 1.0 }, new[] { 1.2 }) }
            };
            foreach (KeyValuePair<string, TrajectoryPoints> item in cases)
                Assert.AreEqual(item.Key, Assert.Throws<RefusedException>(
                    () => item.Value.Checked(Table(), n => 0.0, n => 0.0)).Message);
        }

        static TrajectoryPoints Make(string[] names, double[] times, params double[][] positions)
        {
            return new TrajectoryPoints { names = names, times = times, positions = positions };
        }
    }

    public class ExecutorTests
    {
        class Robot : IJoints
        {
            public readonly Dictionary<string, double> q = new Dictionary<string, double> { { "a", 0 }, { "b", 0 } };
            public readonly Dictionary<string, double> v = new Dictionary<string, double> { { "a", 0 }, { "b", 0 } };
            public double stuckAt = double.PositiveInfinity;

            public double Position(string name) { return q[name]; }
            public double Velocity(string name) { return v[name]; }
            public void Command(string name, double to, double speed)
            {
                q[name] = Math.Min(to, stuckAt);
                v[name] = speed;
            }
        }

        readonly Robot m_Robot = new Robot();
        readonly List<string> m_Said = new List<string>();
        Executor m_Executor;
        double m_Now;

        public ExecutorTests()
        {
            JointTable table = new JointTable(new[] { new JointSpec { name = "a" }, new JointSpec { name = "b" } });
            m_Executor = new Executor(table, m_Robot, new ExecutionSettings(), m_Said.Add);
        }

        void Run(double until)
        {
            for (; m_Now < until - 1e-9; m_Now += 0.01) m_Executor.Step(m_Now, 0.01);
        }

        static TrajectoryPoints To(string joint, double q, double seconds)
        {
            return new TrajectoryPoints
            {
                names = new[] { joint }, times = new[] { seconds }, positions = new[] { new[] { q } },
                velocities = new[] { new[] { 0.0 } }
            };
        }

        [Test]
        public void ArrivesAndSaysSo()
        {
            m_Executor.Take(To("a", 1.0, 2.0));
            Run(1.0);
            Assert.AreEqual(0.5, m_Robot.q["a"], 1e-9); // a cubic from rest to rest is half way after half the time
            Assert.AreEqual(0.75, m_Robot.v["a"], 1e-9);
            Run(2.1);
            Assert.AreEqual("executing 2 points, 2.00 s|done: final error 0.0000", string.Join("|", m_Said));
            Assert.IsFalse(m_Executor.IsMoving);
        }

        [Test]
        public void ANewerOneTakesOverWithoutAJump()
        {
            m_Executor.Take(To("a", 1.0, 2.0));
            Run(1.0);
            double q = m_Robot.q["a"];
            m_Executor.Take(To("a", 0.0, 2.0));
            Run(1.02);
            Assert.AreEqual(q + 0.02 * 0.75, m_Robot.q["a"], 1e-3); // goes on at its speed, then turns round
            Run(3.2);
            Assert.AreEqual("stopped: cancelled at 1.00 of 2.00 s", m_Said[1]);
            Assert.AreEqual("done: final error 0.0000", m_Said.Last());
        }

        [Test]
        public void OtherJointsRunBeside()
        {
            m_Executor.Take(To("a", 1.0, 2.0));
            m_Executor.Take(To("b", 1.0, 1.0));
            Run(2.1);
            Assert.AreEqual(2, m_Said.Count(s => s.StartsWith("done")));
            Assert.AreEqual(0, m_Said.Count(s => s.StartsWith("stopped")));
        }

        [Test]
        public void EmptyStops()
        {
            m_Executor.Take(To("a", 1.0, 2.0));
            Run(1.0);
            m_Executor.Take(new TrajectoryPoints());
            double q = m_Robot.q["a"];
            Run(1.5);
            Assert.AreEqual(q, m_Robot.q["a"], 0.0);
            Assert.AreEqual(0.0, m_Robot.v["a"], 0.0);
            Assert.AreEqual("stopped: cancelled at 1.00 of 2.00 s|stop|done: empty trajectory: stopped",
                string.Join("|", m_Said.Skip(1)));
        }

        [Test]
        public void AWrongStartFails()
        {
            TrajectoryPoints points = To("a", 1.0, 2.0);
            points.times = new[] { 0.0, 2.0 };
            points.positions = new[] { new[] { 0.2 }, new[] { 1.0 } };
            points.velocities = null;
            m_Executor.Take(points);
            Run(0.1);
            Assert.AreEqual("refused: a is 0.200 from the trajectory's start (tolerance 0.01): the robot moved since it "
                + "was planned; plan again from the current state", m_Said.Last());
            Assert.AreEqual(0.0, m_Robot.q["a"], 0.0);
        }

        [Test]
        public void ASmallDifferenceAtTheStartFadesOut()
        {
            m_Robot.q["a"] = 0.008;
            TrajectoryPoints points = new TrajectoryPoints
            {
                names = new[] { "a" }, times = new[] { 0.0, 2.0 }, positions = new[] { new[] { 0.0 }, new[] { 0.0 } }
            };
            m_Executor.Take(points);
            double last = m_Robot.q["a"];
            while (m_Now < 0.3)
            {
                Run(m_Now + 0.01);
                Assert.IsTrue(m_Robot.q["a"] <= last + 1e-12 && last - m_Robot.q["a"] < 1e-3);
                last = m_Robot.q["a"];
            }
            Assert.AreEqual(0.0, last, 1e-12);
        }

        [Test]
        public void ABlockedJointFails()
        {
            m_Robot.stuckAt = 0.3;
            m_Executor.Take(To("a", 1.0, 2.0));
            Run(2.0);
            Assert.IsTrue(m_Said.Last().StartsWith("failed: a left the path by 0.1"));
            Assert.IsFalse(m_Executor.IsMoving);
        }

        [Test]
        public void OneThatDoesNotArriveFails()
        {
            m_Robot.stuckAt = 0.98;
            m_Executor.Take(To("a", 1.0, 2.0));
            Run(3.2);
            Assert.AreEqual("failed: a ended 0.0200 from the goal (tolerance 0.005)", m_Said.Last());
        }
    }

    public class GripTests
    {
        readonly List<string> m_Said = new List<string>();
        double m_Now;

        Grip Make(GripMode mode)
        {
            return new Grip(new GripSettings { mode = mode }, 0.08, m_Said.Add);
        }

        GripAction Run(Grip grip, double seconds, double width, string pressed, double slip = 0)
        {
            GripAction found = GripAction.None;
            for (double end = m_Now + seconds; m_Now < end; m_Now += 0.005)
            {
                GripAction action = grip.Step(m_Now, 0.005, width, pressed, slip, 0);
                if (action != GripAction.None) found = action;
            }
            return found;
        }

        [Test]
        public void WidthOrForce()
        {
            Grip grip = Make(GripMode.Friction);
            grip.Command(0.04, 0, 0.08);
            Assert.AreEqual(0.04, grip.Target, 0.0);
            Assert.AreEqual(70.0, grip.Force, 0.0);
            grip.Command(-20, 0, 0.08);
            Assert.AreEqual(0.0, grip.Target, 0.0);
            Assert.AreEqual(20.0, grip.Force, 0.0);
            grip.Command(double.NaN, 0, 0.08);
            Assert.AreEqual("refused: gripper command nan", m_Said.Last());
            Assert.AreEqual(20.0, new GripSettings().JointForce(20), 0.0);
        }

        [Test]
        public void FingersAreLedAtTheirSpeed()
        {
            Grip grip = Make(GripMode.Friction);
            grip.Command(0.0, 0, 0.08);
            Run(grip, 0.1, 0.08, null);
            Assert.AreEqual(0.08 - 2 * 0.05 * 0.1, grip.SetPoint, 1e-3);
        }

        [Test]
        public void FrictionNeverWelds()
        {
            Grip grip = Make(GripMode.Friction);
            grip.Command(0, 0, 0.08);
            Assert.AreEqual(GripAction.None, Run(grip, 2.0, 0.05, "cube", 0.01));
            Assert.AreEqual("cube", grip.Held);
            Assert.AreEqual("done: holds cube", string.Join("|", m_Said));
        }

        [Test]
        public void WeldFixesAndOpeningReleases()
        {
            Grip grip = Make(GripMode.Weld);
            grip.Command(0, 0, 0.08);
            Assert.AreEqual(GripAction.None, Run(grip, 0.15, 0.05, "cube"));
            Assert.AreEqual(GripAction.Weld, Run(grip, 0.2, 0.05, "cube"));
            Assert.AreEqual("weld: cube is fixed to the hand (weld): both fingers press it", m_Said[0]);
            grip.Command(0.08, m_Now, 0.05);
            Assert.AreEqual(GripAction.Release, Run(grip, 0.1, 0.06, null));
            Assert.IsNull(grip.Held);
            Assert.AreEqual(1, m_Said.Count(s => s == "release: cube"));
        }

        [Test]
        public void HybridWeldsOnlyWhatSlips()
        {
            Grip grip = Make(GripMode.Hybrid);
            grip.Command(0, 0, 0.08);
            Assert.AreEqual(GripAction.Remember, Run(grip, 0.5, 0.05, "cube"));
            Assert.AreEqual(GripAction.None, Run(grip, 1.0, 0.05, "cube", 0.0019));
            Assert.AreEqual(GripAction.Weld, Run(grip, 0.1, 0.05, null, 0.0023)); // contact lost while it slips
            Assert.AreEqual("weld: cube is fixed to the hand (hybrid): it slipped 2.30 mm and 0.00 deg", m_Said.Last());
            grip.Broken();
            Assert.AreEqual("weld broke: cube", m_Said.Last());
            Assert.IsFalse(grip.IsWelded);
        }

        [Test]
        public void ATrajectoryOfArmAndFingersLeadsThem()
        {
            Grip grip = Make(GripMode.Weld);
            grip.Command(0, 0, 0.08);
            Run(grip, 0.5, 0.05, "cube");
            Assert.IsTrue(grip.IsWelded);
            grip.Lead(0.05, 0.05); // where it is: it stays welded
            Assert.IsTrue(grip.IsWelded);
            grip.Lead(0.06, 0.05);
            Assert.AreEqual(0.06, grip.SetPoint, 0.0);
            Assert.AreEqual(GripAction.Release, Run(grip, 0.01, 0.05, "cube"));
        }

        [Test]
        public void NothingBetweenTheFingers()
        {
            Grip grip = Make(GripMode.Friction);
            string ended = null;
            grip.Move(0.0, 0, m_Now, 0.08, text => ended = text);
            Run(grip, 0.1, 0.0005, null);
            Assert.AreEqual("done: stands at 0.5 mm", ended);
        }
    }

    public class FileTests
    {
        [Test]
        public void JsonSaysWhatIsWrongAndWhere()
        {
            Json json = Json.Parse("{\"a\": [1, -2.5e3, true], \"b\": {\"c\": \"x\\u0041\\n\"}}");
            Assert.AreEqual(-2500.0, json["a"].Items[1].Number, 0.0);
            Assert.AreEqual("xA\n", json["b"]["c"].Text);
            Assert.AreEqual("/b has no 'd'", Assert.Throws<FormatException>(() => { var d = json["b"]["d"]; }).Message);
            Assert.AreEqual("/a/2 is not a number",
                Assert.Throws<FormatException>(() => { var n = json["a"].Items[2].Number; }).Message);
            foreach (string bad in new[] { "", "{", "[1,]", "{\"a\": 1, \"a\": 2}", "nul", "1 2", "\"\\x\"",
                new string('[', 100) })
                Assert.Throws<FormatException>(() => Json.Parse(bad));
        }

        [Test]
        public void RatesKeepTheirMean()
        {
            Rate rate = new Rate(30);
            int count = 0;
            for (int i = 0; i < 2000; i++) if (rate.Due(i * 0.005)) count++;
            Assert.AreEqual(300, count);
            Assert.IsTrue(rate.Due(100.0)); // after a pause once, not for every period that was missed
            Assert.IsFalse(rate.Due(100.005));
        }

        [Test]
        public void SolidsAreClosedAndPointOutwards()
        {
            var volumes = new Dictionary<Triangles, double>
            {
                { Solids.Box(new Vec3(1, 2, 3)), 6.0 },
                { Solids.Cylinder(0.5, 2.0), Math.PI * 0.5 },
                { Solids.Cone(0.5, 2.0), Math.PI * 0.5 / 3 },
                { Solids.Sphere(0.5), Math.PI / 6 },
                { Solids.Capsule(0.5, 2.0), Math.PI * 0.5 + Math.PI / 6 }
            };
            foreach (KeyValuePair<Triangles, double> item in volumes)
            {
                double volume = 0.0;
                Triangles t = item.Key;
                for (int i = 0; i < t.indices.Count; i += 3)
                {
                    Vec3 a = t.corners[t.indices[i]], b = t.corners[t.indices[i + 1]], c = t.corners[t.indices[i + 2]];
                    volume += (a.x * (b.y * c.z - b.z * c.y) + a.y * (b.z * c.x - b.x * c.z)
                        + a.z * (b.x * c.y - b.y * c.x)) / 6.0;
                }
                Assert.AreEqual(item.Value, volume, 0.02 * item.Value); // 32 sides: inside by up to 1.3 %
            }
        }

        [Test]
        public void UrdfSaysWhatIsWrong()
        {
            string robot = "<robot name='r'><link name='a'/><link name='b'/>"
                + "<joint name='j' type='{0}'><parent link='a'/><child link='{1}'/></joint></robot>";
            Assert.AreEqual("a", Urdf.Read(string.Format(robot, "continuous", "b")).Root.name);
            foreach (string[] bad in new[] { new[] { "floating", "b" }, new[] { "fixed", "c" } })
                Assert.Throws<FormatException>(() => Urdf.Read(string.Format(robot, bad[0], bad[1])));
            Assert.Throws<FormatException>(() => Urdf.Read("<!DOCTYPE x [<!ENTITY e 'e'>]><robot/>"));
            Assert.Throws<FormatException>(() => Urdf.Read("<robot"));
        }
    }
}
