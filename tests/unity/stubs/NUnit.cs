// As much of NUnit as the package's tests use, and a program that runs them.
using System;
using System.Linq;
using System.Reflection;

namespace NUnit.Framework
{
    public class TestAttribute : Attribute { }
    public class AssertionException : Exception { public AssertionException(string text) : base(text) { } }

    public static class Assert
    {
        public static void AreEqual(object expected, object actual)
        {
            if (!Equals(expected, actual)) throw new AssertionException("expected " + expected + ", got " + actual);
        }
        public static void AreEqual(double expected, double actual, double tolerance)
        {
            if (!(Math.Abs(expected - actual) <= tolerance) && !expected.Equals(actual))
                throw new AssertionException("expected " + expected.ToString("R") + ", got " + actual.ToString("R"));
        }
        public static void IsTrue(bool value) { AreEqual(true, value); }
        public static void IsFalse(bool value) { AreEqual(false, value); }
        public static void IsNull(object value) { AreEqual(null, value); }
        public static T Throws<T>(Action action) where T : Exception
        {
            try
            {
                action();
            }
            catch (T error)
            {
                return error;
            }
            throw new AssertionException("no " + typeof(T).Name);
        }
    }
}

public static class RunTests
{
    public static int Main()
    {
        int failed = 0, run = 0;
        foreach (MethodInfo test in typeof(RunTests).Assembly.GetTypes().SelectMany(t => t.GetMethods())
            .Where(m => m.GetCustomAttributes(typeof(NUnit.Framework.TestAttribute), false).Length > 0))
        {
            run++;
            try
            {
                test.Invoke(Activator.CreateInstance(test.DeclaringType), null);
            }
            catch (TargetInvocationException error)
            {
                failed++;
                Console.WriteLine("FAILED " + test.DeclaringType.Name + "." + test.Name + ": " + error.InnerException);
            }
        }
        Console.WriteLine(run + " run, " + failed + " failed");
        return failed == 0 ? 0 : 1;
    }
}
