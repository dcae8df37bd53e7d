// What the example in docs/with_unity.md uses of Unity and of ROSConnection, so that Mono can compile it.
using System;
using Unity.Robotics.ROSTCPConnector.MessageGeneration;

namespace UnityEngine
{
    public class MonoBehaviour { }
    public static class Debug
    {
        public static void Log(object message) { Console.WriteLine(message); }
    }
}

namespace Unity.Robotics.ROSTCPConnector
{
    public class ROSConnection
    {
        public static ROSConnection GetOrCreateInstance() => new ROSConnection();
        public void Subscribe<T>(string topic, Action<T> callback) where T : Message { }
        public void RegisterPublisher<T>(string topic) where T : Message { }
        public void Publish(string topic, Message message) { }
    }
}
