// What the package's editor script uses of UnityEditor's API: for compiling only.
using System;
using UnityEngine.SceneManagement;

namespace UnityEditor
{
    public class MenuItem : Attribute { public MenuItem(string path) { } }

    public static class EditorUtility
    {
        public static string OpenFilePanel(string title, string directory, string extension) { return ""; }
        public static bool DisplayDialog(string title, string message, string ok) { return true; }
    }

    public static class Undo
    {
        public static void RegisterCreatedObjectUndo(UnityEngine.Object made, string name) { }
    }

    public static class Selection { public static UnityEngine.GameObject activeGameObject; }

    public static class AssetDatabase
    {
        public static void CreateAsset(UnityEngine.Object asset, string path) { }
        public static void Refresh() { }
    }
}

namespace UnityEditor.SceneManagement
{
    public enum NewSceneSetup { EmptyScene, DefaultGameObjects }
    public enum NewSceneMode { Single, Additive }

    public static class EditorSceneManager
    {
        public static bool MarkSceneDirty(Scene scene) { return true; }
        public static Scene NewScene(NewSceneSetup setup, NewSceneMode mode) { return new Scene(); }
        public static bool SaveScene(Scene scene, string path) { return true; }
    }
}
