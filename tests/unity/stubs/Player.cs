// Plays a cell that `armcell export unity` wrote:
//   player.exe scene.json HOST:PORT SPEED    in real time times SPEED, joined to an endpoint, until stdin ends
//   player.exe scene.json                    by what stdin tells, as fast as it can; messages out as hex
// Lines of stdin: "in TIME TOPIC HEX", "slip TIME M_PER_S", "poses TIME", "frictions TIME", "speed TIME RAD_PER_S",
// "block TIME NAME X Y Z" (a box of 0.2 x 0.4 x 0.6 m in Unity's axes, told to the planner),
// "shift TIME NAME X", "mode NAME", "drives" (print drive targets at every step), "until TIME".
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Globalization;
using System.Linq;
using System.Reflection;
using System.Threading;
using Armcell;
using Armcell.Logic;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

public static class Player
{
    static readonly Engine s_Engine = new Engine();
    static GameObject s_Root;

    public static int Main(string[] arguments)
    {
        foreach (Type type in typeof(Player).Assembly.GetTypes().Concat(typeof(Echo).Assembly.GetTypes()).Distinct())
        {
            MethodInfo register = type.GetMethod("Register", BindingFlags.Static | BindingFlags.Public, null,
                Type.EmptyTypes, null);
            if (register != null) register.Invoke(null, null);
        }
        s_Root = CellBuilder.Build(arguments[0]);
        return arguments.Length > 1 ? Join(arguments[1], Number(arguments[2])) : Script();
    }

    static int Join(string address, double speed)
    {
        ROSConnection ros = ROSConnection.GetOrCreateInstance();
        ros.Connect(address.Split(':')[0], int.Parse(address.Split(':')[1]));
        s_Engine.Play();
        bool ended = false;
        new Thread(() => { while (Console.ReadLine() != null) { } ended = true; }) { IsBackground = true }.Start();
        Stopwatch clock = Stopwatch.StartNew();
        while (!ended && !ros.Closed)
        {
            ros.Update();
            if (Time.fixedTimeAsDouble < clock.Elapsed.TotalSeconds * speed) s_Engine.Step();
            else Thread.Sleep(1);
        }
        return 0;
    }

    static int Script()
    {
        List<string[]> lines = new List<string[]>();
        string line;
        while ((line = Console.ReadLine()) != null) lines.Add(line.Split(' '));
        ROSConnection ros = ROSConnection.GetOrCreateInstance();
        ros.Sink = (topic, type, body) => Out("out", topic, type, BitConverter.ToString(body).Replace("-", ""));
        foreach (string[] mode in lines.Where(l => l[0] == "mode"))
            foreach (GripperController gripper in Engine.All<GripperController>())
                gripper.settings.mode = (GripMode)Enum.Parse(typeof(GripMode), mode[1], true);
        s_Engine.Play();
        Queue<string[]> waiting = new Queue<string[]>(
            lines.Where(l => l.Length > 1 && l[0] != "mode" && l[0] != "until").OrderBy(l => Number(l[1])));
        double until = Number(lines.Single(l => l[0] == "until")[1]);
        bool drives = lines.Any(l => l[0] == "drives");
        while (Time.fixedTimeAsDouble < until)
        {
            while (waiting.Count > 0 && Number(waiting.Peek()[1]) <= Time.fixedTimeAsDouble + 1e-9) Do(waiting.Dequeue(), ros);
            s_Engine.Step();
            if (drives)
                foreach (JointMap.MappedJoint joint in s_Root.GetComponent<JointMap>().joints)
                    Out("drive", joint.spec.name, joint.body.xDrive.target, joint.body.xDrive.targetVelocity);
        }
        return 0;
    }

    static void Do(string[] words, ROSConnection ros)
    {
        switch (words[0])
        {
            case "in":
                byte[] data = new byte[words[3].Length / 2];
                for (int i = 0; i < data.Length; i++) data[i] = Convert.ToByte(words[3].Substring(2 * i, 2), 16);
                ros.Receive(words[2], data);
                break;
            case "slip":
                s_Engine.Slip = (float)Number(words[2]);
                break;
            case "speed":
                ArticulationBody.MaxSpeed = Number(words[2]);
                break;
            case "poses":
                foreach (Transform link in Engine.All<Transform>())
                {
                    Vector3 p = link.position;
                    Quaternion q = link.rotation;
                    Out("pose", link.name, p.x, p.y, p.z, q.x, q.y, q.z, q.w);
                }
                break;
            case "frictions": // of every collider, by the names of its object and of the object's parent
                foreach (Collider collider in Engine.All<Collider>())
                {
                    PhysicMaterial material = collider.sharedMaterial;
                    Out("friction", collider.transform.parent.name, material.staticFriction,
                        material.dynamicFriction, material.frictionCombine.ToString());
                }
                break;
            case "block":
                Block(words);
                break;
            case "shift":
                GameObject.All.Single(o => o.name == words[2]).transform.position += Vector3.right * (float)Number(words[3]);
                break;
            default: throw new ArgumentException(words[0]);
        }
    }

    static void Block(string[] words)
    {
        PlanningSceneExporter exporter = s_Root.GetComponent<PlanningSceneExporter>();
        if (exporter == null) exporter = s_Root.AddComponent<PlanningSceneExporter>();
        GameObject made = new GameObject(words[2]);
        made.transform.position = new Vector3((float)Number(words[3]), (float)Number(words[4]), (float)Number(words[5]));
        made.transform.localScale = new Vector3(0.2f, 0.4f, 0.6f);
        made.AddComponent<BoxCollider>();
        exporter.roots = exporter.roots.Concat(new[] { made.transform }).ToArray();
    }

    static void Out(string kind, params object[] words)
    {
        Console.WriteLine(kind + " " + Text(Time.fixedTimeAsDouble) + " " + string.Join(" ", words.Select(Text).ToArray()));
    }

    static string Text(object value)
    {
        IFormattable number = value as IFormattable;
        return number == null ? value.ToString() : number.ToString("R", CultureInfo.InvariantCulture);
    }

    static double Number(string text)
    {
        return double.Parse(text, CultureInfo.InvariantCulture);
    }
}
