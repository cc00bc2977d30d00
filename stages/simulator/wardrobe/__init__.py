"""What a person may wear and carry beyond an outfit: other materials, folds, straps, things in hands, loose hair."""
