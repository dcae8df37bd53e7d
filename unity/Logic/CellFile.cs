using System;
using System.Collections.Generic;

namespace Armcell.Logic
{
    public struct PoseData
    {
        public Vec3 position; // [m], ROS's axes
        public Quat rotation;
    }

    public class ShapeData
    {
        public string type; // box, sphere, cylinder, capsule, cone, plane, mesh
        public PoseData pose; // in the object
        public Vec3 size; // [m] of a box, full lengths
        public double radius, length; // [m]
        public string visual; // mesh file, from the cell file's folder
        public List<string> hulls = new List<string>();
    }

    public class ObjectData
    {
        public string name;
        public PoseData pose; // in the world
        public bool movable;
        public double mass; // [kg] of what is movable
        public double staticFriction, dynamicFriction;
        public double[] color; // RGBA 0 to 1
        public string topic; // that its pose is published on, of what is movable
        public List<ShapeData> shapes = new List<ShapeData>();
    }

    public class GripperData
    {
        public string name, joint, tcpLink, topic;
        public List<string> fingerLinks = new List<string>();
        public GripSettings settings = new GripSettings();
    }

    public struct DriveData
    {
        public double stiffness, damping; // [Nm/rad, Nm s/rad] or [N/m, N s/m]
        public double forceLimit; // [Nm or N]
    }

    /// <summary>What `armcell export unity` writes into scene.json. Frames and units are ROS's.</summary>
    public class CellFile
    {
        public const int Format = 1;

        public string name, urdf;
        public Dictionary<string, double> start = new Dictionary<string, double>();
        public Dictionary<string, DriveData> drives = new Dictionary<string, DriveData>();
        public List<string[]> mayTouch = new List<string[]>();
        public List<GripperData> grippers = new List<GripperData>();
        public List<ObjectData> objects = new List<ObjectData>();
        public double fixedTimestep;
        public int solverIterations, solverVelocityIterations;
        public Vec3 gravity; // [m/s^2], ROS's axes
        public ExecutionSettings execution = new ExecutionSettings();
        public double rate; // [Hz] of the states

        /// <exception cref="FormatException">what is missing or wrong, and where</exception>
        public static CellFile Read(string text)
        {
            Json json = Json.Parse(text);
            if ((int)json["format"].Number != Format)
                throw new FormatException("this package reads format " + Format + ", the file has "
                    + Words.G(json["format"].Number) + ": export again with the armcell this package came with");
            CellFile cell = new CellFile();
            cell.name = json["name"].Text;
            cell.rate = json["rate"].Number;
            Json robot = json["robot"], physics = json["physics"];
            cell.urdf = robot["urdf"].Text;
            foreach (KeyValuePair<string, Json> item in robot["start"].Members)
                cell.start.Add(item.Key, item.Value.Number);
            foreach (KeyValuePair<string, Json> item in robot["drives"].Members)
                cell.drives.Add(item.Key, new DriveData
                {
                    stiffness = item.Value["stiffness"].Number,
                    damping = item.Value["damping"].Number,
                    forceLimit = item.Value.NumberOr("force_limit", double.PositiveInfinity)
                });
            foreach (Json pair in robot["may_touch"].Items)
                cell.mayTouch.Add(pair.Items.ConvertAll(n => n.Text).ToArray());
            foreach (Json gripper in robot["grippers"].Items)
                cell.grippers.Add(Gripper(gripper, physics));
            foreach (Json item in json["objects"].Items)
                cell.objects.Add(Object(item));
            cell.fixedTimestep = physics["fixed_timestep"].Number;
            cell.solverIterations = (int)physics["solver_iterations"].Number;
            cell.solverVelocityIterations = (int)physics["solver_velocity_iterations"].Number;
            double[] g = physics["gravity"].Numbers(3);
            cell.gravity = new Vec3(g[0], g[1], g[2]);
            Json execution = json["execution"];
            cell.execution.startTolerance = execution["start_tolerance"].Number;
            cell.execution.pathTolerance = execution["path_tolerance"].Number;
            cell.execution.goalTolerance = execution["goal_tolerance"].Number;
            cell.execution.goalSpeed = execution["goal_speed"].Number;
            cell.execution.settleTime = execution["settle_time"].Number;
            return cell;
        }

        static GripperData Gripper(Json json, Json physics)
        {
            GripperData data = new GripperData();
            data.name = json["name"].Text;
            data.joint = json["joint_name"].Text;
            data.tcpLink = json["tcp_link"].Text;
            data.topic = json["topic"].Text;
            data.fingerLinks = json["finger_links"].Items.ConvertAll(n => n.Text);
            data.settings.maxWidth = json["max_width"].Number;
            data.settings.maxForce = json["max_force"].Number;
            data.settings.widthPerJoint = json["width_per_joint"].Number;
            data.settings.widthOffset = json["width_offset"].Number;
            data.settings.fingerSpeed = physics["finger_speed"].Number;
            data.settings.slip = physics["hybrid_slip"].Number;
            data.settings.turn = physics["hybrid_turn"].Number;
            data.settings.mode = (GripMode)Enum.Parse(typeof(GripMode), physics["grip_mode"].Text, true);
            return data;
        }

        static ObjectData Object(Json json)
        {
            ObjectData data = new ObjectData();
            data.name = json["name"].Text;
            data.pose = Pose(json["pose"]);
            data.movable = json["movable"].Truth;
            data.staticFriction = json["friction"].Number;
            data.dynamicFriction = json.NumberOr("dynamic_friction", data.staticFriction);
            data.color = json["color"].Numbers(4);
            if (data.movable)
            {
                data.mass = json["mass"].Number;
                data.topic = json["topic"].Text;
            }
            foreach (Json shape in json["shapes"].Items) data.shapes.Add(Shape(shape));
            return data;
        }

        static ShapeData Shape(Json json)
        {
            ShapeData data = new ShapeData();
            data.type = json["type"].Text;
            data.pose = Pose(json["pose"]);
            data.radius = json.NumberOr("radius", 0.0);
            data.length = json.NumberOr("length", 0.0);
            if (json.Has("size"))
            {
                double[] size = json["size"].Numbers(3);
                data.size = new Vec3(size[0], size[1], size[2]);
            }
            if (json.Has("visual")) data.visual = json["visual"].Text;
            if (json.Has("hulls")) data.hulls = json["hulls"].Items.ConvertAll(h => h.Text);
            return data;
        }

        static PoseData Pose(Json json)
        {
            double[] p = json["position"].Numbers(3), q = json["quat_xyzw"].Numbers(4);
            return new PoseData { position = new Vec3(p[0], p[1], p[2]), rotation = new Quat(q[0], q[1], q[2], q[3]) };
        }
    }
}
