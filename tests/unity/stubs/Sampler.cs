// Samples trajectories with the package's own interpolation, in full precision: a JSON object per line of stdin,
// {"times": [], "positions": [[]], "velocities": [[]], "accelerations": [[]], "at": []}, the two in the middle may be missing; a line of
// positions and one of velocities for each time.
using System;
using System.Globalization;
using System.Linq;
using Armcell.Logic;

public static class Sampler
{
    public static void Main()
    {
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            Json json = Json.Parse(line);
            double[][] positions = Rows(json, "positions");
            string[] names = Enumerable.Range(0, positions[0].Length).Select(i => "j" + i).ToArray();
            JointTrajectory trajectory = new JointTrajectory(
                names, Row(json["times"]), positions, Rows(json, "velocities"), Rows(json, "accelerations"));
            double[] q = new double[names.Length], v = new double[names.Length];
            foreach (double t in Row(json["at"]))
            {
                trajectory.Sample(t, q, v);
                foreach (double[] row in new[] { q, v })
                    Console.WriteLine(string.Join(" ", row.Select(x => x.ToString("R", CultureInfo.InvariantCulture))));
            }
        }
    }

    static double[] Row(Json json)
    {
        return json.Items.Select(i => i.Number).ToArray();
    }

    static double[][] Rows(Json json, string key)
    {
        return json.Has(key) ? json[key].Items.Select(Row).ToArray() : null;
    }
}
