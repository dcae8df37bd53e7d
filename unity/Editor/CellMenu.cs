using System;
using System.IO;
using UnityEditor;
using UnityEditor.SceneManagement;
using UnityEngine;
using UnityEngine.SceneManagement;

namespace Armcell
{
    /// <summary>Builds a cell that `armcell export unity` wrote, from the menu or from a command line.</summary>
    public static class CellMenu
    {
        [MenuItem("Armcell/Build Cell...")]
        public static void Build()
        {
            string file = EditorUtility.OpenFilePanel("A cell's scene.json", "Assets/Armcell", "json");
            if (string.IsNullOrEmpty(file)) return;
            try
            {
                GameObject root = Build(file);
                Undo.RegisterCreatedObjectUndo(root, "Build cell");
                Selection.activeGameObject = root;
                EditorSceneManager.MarkSceneDirty(SceneManager.GetActiveScene());
            }
            catch (Exception error)
            {
                Debug.LogException(error);
                EditorUtility.DisplayDialog("Armcell", error.Message, "OK");
            }
        }

        /// <summary>
        /// Unity -batchmode -quit -projectPath PROJECT -executeMethod Armcell.CellMenu.BuildFromCommandLine
        /// -cell Assets/Armcell/NAME/scene.json: a new scene beside the file.
        /// </summary>
        public static void BuildFromCommandLine()
        {
            string[] words = Environment.GetCommandLineArgs();
            int at = Array.IndexOf(words, "-cell");
            if (at < 0 || at + 1 >= words.Length) throw new ArgumentException("-cell FILE is missing");
            string file = words[at + 1];
            Scene scene = EditorSceneManager.NewScene(NewSceneSetup.DefaultGameObjects, NewSceneMode.Single);
            Build(file);
            EditorSceneManager.SaveScene(scene, Path.ChangeExtension(file, ".unity"));
        }

        static GameObject Build(string file)
        {
            string folder = "Assets/Armcell/" + Path.GetFileName(Path.GetDirectoryName(Path.GetFullPath(file)))
                + "/Generated";
            GameObject root = CellBuilder.Build(file, new AssetFolder(folder));
            root.AddComponent<PlanningSceneExporter>().world = root.transform; // its roots are the user's to name
            return root;
        }

        /// <summary>Keeps meshes and materials below a folder of the project.</summary>
        class AssetFolder : IKeepAssets
        {
            readonly string m_Folder;

            public AssetFolder(string folder)
            {
                m_Folder = folder;
                Directory.CreateDirectory(folder);
                AssetDatabase.Refresh();
            }

            public void Keep(UnityEngine.Object asset, string name)
            {
                foreach (char c in "/\\: ") name = name.Replace(c, '_');
                string end = asset is Material ? ".mat" : asset is Mesh ? ".asset" : ".physicMaterial";
                AssetDatabase.CreateAsset(asset, m_Folder + "/" + name + end);
            }
        }
    }
}
